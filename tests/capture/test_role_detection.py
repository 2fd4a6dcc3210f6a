"""Which end is the server, by port and by what is said."""

from __future__ import annotations

import pytest

from bcapscope.capture.role_detection import (
    BCAP_PORTS,
    direction_evidence,
    is_whole_frames,
    may_begin_frame,
    server_index_by_port,
)
from bcapscope.protocol.codec.frame import Frame, Malformed, encode_frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.traffic.observation import Direction, ServerEvidence, ServerEvidenceKind
from tests.capture.packets import reply, request, service_start

HANDLE, NAME = Variant(VT.I4, 1), Variant(VT.BSTR, "slvMove")


@pytest.mark.parametrize(
    ("ends", "server"), [((50001, 5007), 1), ((5007, 50001), 0), ((5007, 5007), None), ((1, 2), None)]
)
def test_exactly_one_end_on_the_port_is_the_server(ends: tuple[int, int], server: int | None) -> None:
    assert server_index_by_port(BCAP_PORTS, *ends) == server


@pytest.mark.parametrize(
    "code", [0, 0x900, 0x80000900, 0x83500121, 0xFFFFFFFF], ids=lambda code: f"0x{code:08X}"
)
def test_such_a_number_can_only_be_a_result(code: int) -> None:
    for arguments in ([], [HANDLE], [EMPTY]):
        found = direction_evidence(Frame(encode_frame(1, 0, code, arguments)))
        assert found == (Direction.RESPONSE, ServerEvidence(ServerEvidenceKind.RESULT, code))


@pytest.mark.parametrize(
    ("code", "arguments"),
    [
        (1, [Variant(VT.BSTR, "")]),
        (2, []),
        (3, [Variant(VT.BSTR, text) for text in ("a", "b", "c", "")]),
        (64, [HANDLE, NAME, EMPTY]),
        (64, [Variant(VT.UI4, 1), NAME, Variant.array(VT.R8, (1.0, 2.0))]),
        (64, [Variant(VT.I2, 1), NAME, Variant.array(VT.VARIANT, (HANDLE,))]),
        (74, [HANDLE, Variant(VT.I4, -1), Variant(VT.R4, 50.0)]),
        (137, [HANDLE]),
    ],
)
def test_a_function_with_its_arguments_can_only_be_a_request(code: int, arguments: list[Variant]) -> None:
    found = direction_evidence(Frame(encode_frame(1, 0, code, arguments)))
    assert found == (Direction.REQUEST, ServerEvidence(ServerEvidenceKind.CALL, code))


@pytest.mark.parametrize(
    "item",
    [
        Frame(encode_frame(1, 0, 1)),  # S_FALSE, or Service_Start without its option
        Frame(encode_frame(1, 0, 1, [HANDLE])),
        Frame(encode_frame(1, 0, 64, [HANDLE])),
        Frame(encode_frame(1, 0, 64, [NAME, HANDLE, EMPTY])),
        Frame(encode_frame(1, 0, 64, [Variant.array(VT.I4, (1,)), NAME, EMPTY])),
        Frame(encode_frame(1, 0, 138, [HANDLE])),
        Frame(encode_frame(1, 0, 0x0F200501)),
        Frame(encode_frame(1, 0, 0)[:-1] + b"\x05"),
        Malformed(b"x", ()),
    ],
)
def test_all_else_proves_nothing(item: Frame | Malformed) -> None:
    assert direction_evidence(item) is None


def test_a_stream_that_may_begin_with_a_frame() -> None:
    frame = request(1)
    for cut in range(1, len(frame) + 1):
        assert may_begin_frame(frame[:cut])
    assert may_begin_frame(frame + b"anything")
    for other in (
        b"",
        b"GET / HTTP/1.1",
        frame[1:],
        frame[:-1] + b"\x05",
        b"\x01\x0f\x00\x00\x00" + frame[5:],
        b"\x01\xff\xff\xff\xff" + frame[5:],
        frame[:13] + b"\x41\x00" + frame[15:],
    ):
        assert not may_begin_frame(other)


def test_a_datagram_is_whole_frames_and_nothing_else() -> None:
    for frames in ([request(1)], [reply(1), reply(2)], [service_start()] * 3):
        assert is_whole_frames(b"".join(frames))
    for other in (b"", b"\x01", request(1)[:-1], request(1) + b"\x01", request(1) + reply(1)[:-1], bytes(40)):
        assert not is_whole_frames(other)
