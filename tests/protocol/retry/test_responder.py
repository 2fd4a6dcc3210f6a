"""Playbooks of requests that come once, again, late or not at all, and what the responder makes of them."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.errors import LocalProtocolError, TooLargeError
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.reserved_convention import ReplyReserved, ReservedConvention
from bcapscope.protocol.retry.responder import Defect, RequestDecision, RequestKind, Responder
from bcapscope.protocol.tables.hresult import E_BUSY, S_EXECUTING, S_OK

NEW, REPEAT, RUNNING, BUSY = RequestKind.NEW, RequestKind.REPEAT, RequestKind.RUNNING, RequestKind.BUSY


def _request(serial: int, reserved: int, what: int = 0) -> Frame:
    return Frame(encode_frame(serial, reserved, 64, (Variant(VT.I4, what),)))


def _play(responder: Responder, *packets: tuple[int, int, int]) -> str:
    """Send packets (serial, reserved, contents), answer each new call at once, spell the verdicts."""
    verdicts = []
    for packet in packets:
        verdict = responder.receive_request(_request(*packet)).kind
        verdicts.append(verdict.name)
        if verdict is NEW:
            responder.answer_call(S_OK)
    return " ".join(verdicts)


@pytest.mark.parametrize(
    ("packets", "verdicts"),
    [
        ([(1, 0, 0), (2, 0, 1), (3, 0, 2)], "NEW NEW NEW"),
        ([(1, 0, 0), (2, 0, 0), (3, 0, 0)], "NEW NEW NEW"),
        ([(1, 0, 0), (1, 0, 0)], "NEW REPEAT"),
        ([(5, 0, 0), (6, 5, 0), (7, 5, 0)], "NEW REPEAT REPEAT"),
        ([(6, 5, 0), (7, 5, 0)], "NEW REPEAT"),
        ([(7, 5, 0), (6, 5, 0), (5, 0, 0)], "NEW REPEAT REPEAT"),
        ([(5, 5, 0), (6, 5, 0), (7, 5, 0)], "NEW REPEAT REPEAT"),
        ([(6, 5, 0), (5, 5, 0)], "NEW REPEAT"),
        ([(5, 0, 0), (6, 5, 0), (7, 6, 0)], "NEW REPEAT REPEAT"),
        ([(5, 0, 0), (7, 6, 0), (8, 7, 0)], "NEW REPEAT REPEAT"),
        ([(7, 6, 0), (5, 0, 0), (6, 5, 0)], "NEW REPEAT REPEAT"),
        ([(5, 0, 0), (7, 6, 1)], "NEW NEW"),
        ([(4, 0, 1), (3, 0, 0), (6, 5, 1)], "NEW NEW REPEAT"),
        ([(1, 0, 1), (6, 0, 0), (3, 2, 1)], "NEW NEW REPEAT"),
        ([(65535, 0, 0), (1, 65535, 0), (2, 65535, 0)], "NEW REPEAT REPEAT"),
        ([(65535, 0, 0), (0, 65535, 0), (1, 0, 0)], "NEW REPEAT REPEAT"),
        ([(0, 0, 0), (1, 0, 1), (2, 0, 0)], "NEW NEW NEW"),
        ([(5, 0, 0), (6, 0, 1), (5, 0, 0), (7, 6, 1)], "NEW NEW REPEAT REPEAT"),
        ([(1, 0, 0), (2, 0, 1), (1, 0, 2), (2, 0, 1)], "NEW NEW NEW NEW"),
        ([(1, 0, 0), (6, 5, 2), (1, 0, 0), (4, 0, 3), (6, 0, 4), (4, 0, 3)], "NEW NEW REPEAT NEW NEW REPEAT"),
        ([(5, 0, 2), (4, 0, 3), (6, 5, 3)], "NEW NEW REPEAT"),
        ([(10, 0, 0), (5, 0, 0), (10, 0, 1), (11, 0, 0)], "NEW REPEAT NEW NEW"),
        ([(5, 0, 0), (6, 5, 0), (6, 0, 1), (5, 0, 0)], "NEW REPEAT NEW NEW"),
        ([(10, 0, 0), (9, 0, 1), (9, 0, 0)], "NEW NEW NEW"),
        ([(10, 0, 0), (9, 0, 1), (9, 8, 0)], "NEW NEW REPEAT"),
        ([(20, 0, 0), (5, 0, 0)], "NEW REPEAT"),
        ([(21, 0, 0), (5, 0, 0)], "NEW NEW"),
    ],
    ids=lambda value: value if isinstance(value, str) else str(value),
)
def test_playbook(packets: list[tuple[int, int, int]], verdicts: str) -> None:
    assert _play(Responder(), *packets) == verdicts


def test_a_retry_after_the_last_serial_does_not_show_the_convention() -> None:
    responder = Responder()
    assert _play(responder, (65535, 0, 0), (1, 65535, 0)) == "NEW REPEAT"
    assert responder.convention is ReservedConvention.UNKNOWN


def _responder_for(convention: ReservedConvention) -> Responder:
    """Return a responder that knows the convention of its client."""
    responder = Responder()
    responder.convention = convention
    return responder


def test_retry_of_a_lost_call_is_new_once_the_client_is_known() -> None:
    """An equal call whose first packet was lost: only a chain would make it a retry."""
    ambiguous = [(5, 0, 0), (7, 6, 0)]
    assert _play(Responder(), *ambiguous) == "NEW REPEAT"
    assert _play(_responder_for(ReservedConvention.SEED), *ambiguous) == "NEW NEW"
    assert _play(Responder(), (1, 0, 0), (2, 1, 0), (3, 1, 0), *ambiguous) == "NEW REPEAT REPEAT NEW NEW"
    assert _play(Responder(), (1, 1, 0), *ambiguous) == "NEW NEW NEW"


def test_a_program_that_starts_the_service_is_not_known_from_an_earlier_program() -> None:
    responder = _responder_for(ReservedConvention.SEED)
    assert responder.receive_request(Frame(encode_frame(1, 0, 1, ()))).kind is NEW  # Service_Start
    responder.answer_call(S_OK)
    assert _play(responder, (5, 0, 0), (7, 6, 0)) == "NEW REPEAT"


def test_the_kept_answer_goes_out_under_the_serial_of_the_retry() -> None:
    responder = Responder()
    value = Variant(VT.R8, 1.5)
    responder.receive_request(_request(5, 0))
    assert responder.answer_call(S_OK, (value,)) == encode_frame(5, 0, S_OK, (value,))
    assert responder.receive_request(_request(6, 5)).reply == encode_frame(6, 0, S_OK, (value,))


def test_reserved_is_echoed_where_it_is_to_be() -> None:
    responder = Responder(reply_reserved=ReplyReserved.ECHOED)
    responder.receive_request(_request(5, 0))
    assert responder.answer_call(S_OK) == encode_frame(5, 0, S_OK)
    assert responder.receive_request(_request(6, 5)).reply == encode_frame(6, 5, S_OK)
    assert responder.receive_request(_request(7, 5)).reply == encode_frame(7, 5, S_OK)


def test_answer_and_notice_go_to_the_newest_packet() -> None:
    responder = Responder(reply_reserved=ReplyReserved.ECHOED)
    assert responder.receive_request(_request(5, 0)).kind is NEW
    assert responder.executing_notice() == encode_frame(5, 0, S_EXECUTING)
    assert responder.receive_request(_request(7, 5)) == RequestDecision(RUNNING)
    assert responder.receive_request(_request(6, 5)) == RequestDecision(RUNNING)
    assert responder.is_call_running
    assert responder.executing_notice() == encode_frame(7, 5, S_EXECUTING)
    assert responder.answer_call(S_OK) == encode_frame(7, 5, S_OK)
    assert not responder.is_call_running


def test_another_call_meanwhile_is_refused_and_not_remembered() -> None:
    responder = Responder()
    responder.receive_request(_request(5, 0))
    other = _request(6, 0, 1)
    assert responder.receive_request(other) == RequestDecision(BUSY)
    assert responder.reply_unremembered(other, E_BUSY) == encode_frame(6, 0, E_BUSY)
    responder.answer_call(S_OK)
    assert responder.receive_request(other).kind is NEW


def test_an_abandoned_call_is_not_answered_and_not_executed_again() -> None:
    responder = Responder()
    assert responder.receive_request(_request(5, 0)).kind is RequestKind.NEW
    responder.abandon_call()
    assert not responder.is_call_running
    assert responder.receive_request(_request(6, 5)) == RequestDecision(RequestKind.RUNNING)
    assert responder.receive_request(_request(7, 0)).kind is RequestKind.NEW


def test_what_cannot_be_packed_leaves_the_call_running() -> None:
    responder = Responder()
    responder.receive_request(_request(5, 0))
    with pytest.raises(LocalProtocolError):
        responder.answer_call(S_OK, (Variant(VT.I2, 70000),))
    assert responder.is_call_running
    responder.answer_call(S_OK)


def test_an_answer_that_is_too_large_leaves_the_call_running() -> None:
    text = Variant(VT.BSTR, "x" * 100)
    size = len(encode_frame(1, 0, S_OK, (text,)))
    for largest, fits in ((size, True), (size - 1, False)):
        responder = Responder(largest_answer=largest)
        responder.receive_request(_request(5, 0))
        if fits:
            assert len(responder.answer_call(S_OK, (text,))) == size
        else:
            with pytest.raises(TooLargeError):
                responder.answer_call(S_OK, (text,))
        assert responder.is_call_running is not fits


def test_on_tcp_everything_is_new() -> None:
    assert _play(Responder(expects_retries=False), (5, 0, 0), (5, 0, 0), (6, 5, 0)) == "NEW NEW NEW"


def test_old_answers_are_forgotten() -> None:
    responder = Responder(remembered=2)
    assert _play(responder, (1, 0, 1), (2, 0, 2), (3, 0, 3), (2, 0, 2)) == "NEW NEW NEW REPEAT"
    assert _play(responder, (1, 0, 1)) == "NEW"


def test_none_that_is_remembered_is_forgotten_with_the_old_ones() -> None:
    responder = Responder(remembered=3)
    for serial in range(1, 100):
        assert _play(responder, (serial, 0, serial)) == "NEW"
        for known in range(max(1, serial - 2), serial + 1):
            assert _play(responder, (known, 0, known)) == "REPEAT"


@pytest.mark.parametrize("count", range(20))
def test_a_late_retry_is_known_by_its_contents_however_many_calls_there_were(count: int) -> None:
    responder = Responder(remembered=2)
    calls = [(3 * serial, 0, serial) for serial in range(1, count + 3)]
    assert _play(responder, *calls) == " ".join(["NEW"] * len(calls))
    serial, _, contents = calls[-2]
    assert _play(responder, (serial + 2, serial + 1, contents)) == "REPEAT"


def test_another_function_with_the_same_arguments_is_another_call() -> None:
    responder = Responder()
    assert _play(responder, (5, 0, 0)) == "NEW"
    assert responder.receive_request(Frame(encode_frame(5, 0, 65, (Variant(VT.I4, 0),)))).kind is NEW


def test_what_is_refused_at_once_has_the_reserved_field_of_any_other_answer() -> None:
    request = _request(6, 5)
    assert Responder().reply_unremembered(request, E_BUSY) == encode_frame(6, 0, E_BUSY)
    echoing = Responder(reply_reserved=ReplyReserved.ECHOED)
    assert echoing.reply_unremembered(request, E_BUSY) == encode_frame(6, 5, E_BUSY)


def test_a_forgotten_client_is_a_new_one() -> None:
    responder = Responder()
    responder.receive_request(_request(5, 0))
    responder.reset()
    assert _play(responder, (5, 0, 0)) == "NEW"
    responder.reset()
    assert _play(responder, (5, 0, 0)) == "NEW"


def test_the_c_server_executes_the_second_retry_of_a_lost_first_packet() -> None:
    lost_first = [(6, 5, 0), (7, 5, 0)]
    assert _play(Responder(defects=Defect.FORGETS_FIRST), *lost_first) == "NEW NEW"
    chain = [(6, 5, 0), (7, 6, 0)]
    assert _play(Responder(defects=Defect.FORGETS_FIRST), *chain) == "NEW REPEAT"
    none_lost = [(5, 0, 0), (6, 5, 0), (7, 5, 0), (5, 0, 0)]
    assert _play(Responder(defects=Defect.FORGETS_FIRST), *none_lost) == "NEW REPEAT REPEAT REPEAT"


def test_the_c_server_keeps_one_answer_only() -> None:
    calls = [(1, 0, 0), (2, 0, 1), (1, 0, 0)]
    assert _play(Responder(defects=Defect.FORGETS_FIRST), *calls) == "NEW NEW NEW"
    assert _play(Responder(), *calls) == "NEW NEW REPEAT"


def test_the_c_server_gives_the_old_answer_to_a_client_that_starts_anew() -> None:
    assert _play(Responder(defects=Defect.FORGETS_FIRST), (1, 0, 0), (1, 0, 1)) == "NEW REPEAT"
    assert _play(Responder(), (1, 0, 0), (1, 0, 1)) == "NEW NEW"


def test_the_c_server_answers_serial_zero_without_executing() -> None:
    responder = Responder(defects=Defect.SERIAL_ZERO)
    assert responder.receive_request(_request(0, 0)) == RequestDecision(REPEAT, encode_frame(0, 0, S_OK))
    assert _play(responder, (0, 0, 0)) == "NEW"
    responder.reset()
    assert _play(responder, (0, 0, 0)) == "REPEAT"
    assert _play(Responder(), (0, 0, 0)) == "NEW"
    assert _play(Responder(expects_retries=False, defects=Defect.SERIAL_ZERO), (0, 0, 0)) == "NEW"


_CONVENTIONS = [ReservedConvention.SEED, ReservedConvention.OWN, ReservedConvention.CHAIN]


def _tries(convention: ReservedConvention, first: int, count: int) -> list[tuple[int, int]]:
    """Return serial and reserved of each try of one call."""
    serials = [(first + i - 1) % 65535 + 1 for i in range(count)]
    if convention is ReservedConvention.CHAIN:
        return [(first, 0), *((serial, before) for before, serial in pairwise(serials))]
    own = first if convention is ReservedConvention.OWN else 0
    return [(first, own), *((serial, first) for serial in serials[1:])]


@st.composite
def _packets(draw: st.DrawFn) -> tuple[ReservedConvention, list[tuple[int, int, int, int]]]:
    """Draw what arrives of some calls: (serial, reserved, contents, number of the call).

    Each packet may be lost, come twice, or come up to six packets late.
    """
    convention = draw(st.sampled_from(_CONVENTIONS))
    serial = draw(st.sampled_from([1, 500, 65520]))
    arriving: list[tuple[float, tuple[int, int, int, int]]] = []
    sent = 0
    for call in range(draw(st.integers(1, 12))):
        count = draw(st.integers(1, 8))
        contents = draw(st.integers(0, 1))
        for own, reserved in _tries(convention, serial, count):
            for late in draw(st.lists(st.floats(0, 6), max_size=2)):
                arriving.append((sent + late, (own, reserved, contents, call)))
            sent += 1
        serial = (serial + count - 1) % 65535 + 1
    return convention, [packet for _, packet in sorted(arriving)]


@given(_packets(), st.booleans())
def test_no_call_is_executed_twice(
    traffic: tuple[ReservedConvention, list[tuple[int, int, int, int]]], known: bool
) -> None:
    convention, packets = traffic
    responder = _responder_for(convention if known else ReservedConvention.UNKNOWN)
    executed: Counter[int] = Counter()
    for serial, reserved, contents, call in packets:
        if responder.receive_request(_request(serial, reserved, contents)).kind is NEW:
            executed[call] += 1
            responder.answer_call(S_OK)
    assert all(times == 1 for times in executed.values())


@given(_packets())
def test_what_is_known_not_to_be_a_chain_is_executed_if_anything_of_it_came(
    traffic: tuple[ReservedConvention, list[tuple[int, int, int, int]]],
) -> None:
    convention, packets = traffic
    if convention is ReservedConvention.CHAIN:
        return
    responder = _responder_for(convention)
    executed = set()
    for serial, reserved, contents, call in packets:
        if responder.receive_request(_request(serial, reserved, contents)).kind is NEW:
            executed.add(call)
            responder.answer_call(S_OK)
    assert executed == {call for *_, call in packets}
