"""No disguise gets a request that energises or moves past a read-only guard; no guard stops a stop."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Framing, encode_frame
from bcapscope.protocol.codec.stream_splitter import StreamSplitter
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.tables.command_catalogue import commands_of
from bcapscope.protocol.tables.function_table import FUNCTIONS, ID
from bcapscope.proxy.request_guard import RequestGuard, read_target
from tests.proxy.evasions import Ends, Request, as_data, compressed, dangerous, evasion, stop
from tests.proxy.readings import executed

ENDS = Ends(1, 2, 3)
READ_ONLY = RequestGuard(read_only=True)
BLOCKING = RequestGuard(
    block=[read_target(name) for name in ("Robot_Halt", "Task_Stop", "HandStop", "slvChangeMode")]
)
SEEDS = st.integers(0, 2**32 - 1)


def passed(guard: RequestGuard, data: bytes, stream: bool) -> bytes:
    """Return what a guard passes of a datagram, or of a stream."""
    if not stream:
        return guard.filter_frames(data).passing
    splitter = StreamSplitter(synchronized=True)
    pieces = (*splitter.feed(data), *splitter.close())
    return b"".join(guard.filter_frames(piece.item.raw).passing for piece in pieces)


@given(SEEDS, st.booleans())
@example(0, True)
def test_no_controller_executes_more_than_reading_of_what_passed(seed: int, stream: bool) -> None:
    name, data = evasion(Random(seed), ENDS)
    for call in executed(passed(READ_ONLY, data, stream), stream):
        assert not call.is_dangerous, (name, call, data.hex())


@given(st.lists(SEEDS, min_size=2, max_size=4))
def test_nothing_arises_between_the_frames_of_a_stream(seeds: list[int]) -> None:
    data = b"".join(evasion(Random(seed), ENDS)[1] for seed in seeds)
    assert not any(call.is_dangerous for call in executed(passed(READ_ONLY, data, True), True))


@given(SEEDS, st.sampled_from([Framing.PLAIN, Framing.SERIAL_LINE, Framing.VERSION_1]), st.booleans())
def test_a_stop_passes_every_guard(seed: int, framing: Framing, stream: bool) -> None:
    data = stop(Random(seed), ENDS).encoded(1, framing)
    for guard in (READ_ONLY, BLOCKING):
        assert passed(guard, data, stream) == data


@given(SEEDS)
def test_the_readers_see_what_is_not_disguised(seed: int) -> None:
    request = dangerous(Random(seed), ENDS)
    for stream in (False, True):
        assert all(call.is_dangerous for call in executed(request.encoded(), stream))
        assert executed(request.encoded(), stream)


def test_the_readers_see_through_disguises() -> None:
    found = {
        name
        for seed in range(3000)
        for name, data in [evasion(Random(seed), ENDS)]
        if any(call.is_dangerous for call in executed(data, True))
    }
    assert found >= {"plain", "respelt", "by_lengths", "left_over", "recounted", "in_a_row", "compressed"}


def test_every_function_and_command_is_judged_as_the_readers_judge_it() -> None:
    handle = Variant(VT.I4, 1)
    requests = [Request(each, (handle, Variant(VT.BSTR, ""), Variant(VT.BSTR, ""))) for each in FUNCTIONS]
    for function_id in FUNCTIONS:
        for command in commands_of(function_id):
            name = Variant(VT.BSTR, command.name.swapcase())
            requests += [Request(function_id, (handle, name, value)) for value in (EMPTY, Variant(VT.I4, 1))]
    for request in requests:
        raw = request.encoded()
        (call, *_) = executed(raw, False)
        assert call.is_dangerous or passed(READ_ONLY, raw, False) == raw, request
        assert not call.is_dangerous or not passed(READ_ONLY, raw, False), request


@pytest.mark.parametrize("stream", [False, True])
def test_a_frame_inside_a_value_is_data(stream: bool) -> None:
    for seed in range(50):
        data = as_data(Random(seed), ENDS)
        assert passed(READ_ONLY, data, stream) == data


@pytest.mark.parametrize("reserved", [0, 1, 2, 0xFFFF])
def test_a_release_around_bytes_that_look_compressed_does_not_pass(reserved: int) -> None:
    """As keioku/bcap-python, which unpacks whatever its `reserved` says, a controller would move."""
    blocking = RequestGuard(block=[read_target("Motor")])
    for seed in range(200):
        data = bytearray(compressed(Random(seed), ENDS))
        data[7:9] = reserved.to_bytes(2, "little")
        for guard in (READ_ONLY, blocking):
            assert passed(guard, bytes(data), True) == b""


def test_slave_mode_off_with_one_more_argument_does_not_pass() -> None:
    values = (Variant(VT.I4, 2), Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I4, 0))
    assert passed(READ_ONLY, encode_frame(5, 0, 64, values), False)
    for more in (EMPTY, Variant(VT.I4, 0x102), Variant(VT.I4, 0)):
        assert passed(READ_ONLY, encode_frame(5, 0, 64, (*values, more)), False) == b""


@pytest.mark.parametrize("value", [True, False])
def test_no_variable_is_written_through_a_read_only_guard(value: bool) -> None:
    written = encode_frame(5, 0, ID["Variable_PutValue"], (Variant(VT.I4, 3), Variant(VT.BOOL, value)))
    assert passed(READ_ONLY, written, False) == b""
