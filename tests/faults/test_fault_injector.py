"""Decisions: which messages are struck, what becomes of them, and that chance repeats itself."""

from __future__ import annotations

import itertools
import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.faults.fault import CloseMode
from bcapscope.faults.fault_injector import MAX_WAITING, FaultInjector
from bcapscope.faults.fault_notation import read_fault
from bcapscope.faults.wire_message import CloseConnection, FaultResult, SendBytes
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.tables.hresult import E_FAIL, S_EXECUTING
from bcapscope.traffic.observation import Endpoint, Transport
from tests.english import english
from tests.faults.traffic import (
    MS,
    Talk,
    arrivals,
    closed,
    passes,
    reply,
    request,
    run_dry,
    sent,
    shaper,
    talk,
)

HOUR = 3_600_000 * MS


def through(machine: FaultInjector, flows: Talk, *serials: int) -> list[bytes]:
    """Let requests pass, one a millisecond."""
    return [data for _, data in arrivals(machine, flows.up, [request(serial) for serial in serials])]


@pytest.mark.parametrize(
    ("fault", "needed"),
    [
        ("delay=1ms", False),
        ("partition", False),
        ("pass request", False),
        ("delay=1ms 50%", True),
        ("delay=1ms if serial == 1", True),
        ("delay=1ms try 2", True),
        ("drop", True),
    ],
)
def test_a_fault_needs_whole_frames_only_to_choose_or_change_them(fault: str, needed: bool) -> None:
    assert shaper(fault).needs_frames(0) is needed


def test_without_faults_all_passes_as_it_came() -> None:
    flows = talk()
    machine = shaper()
    raw = request(1)
    taken = machine.process_message(flows.up, raw, 0)
    assert taken == FaultResult([SendBytes(flows.up, raw)])
    assert sent(taken.outputs)[0] is raw
    assert machine.due() is None
    assert machine.is_idle(0)


def notes_of(result: FaultResult) -> tuple[str, ...]:
    return tuple(map(str, result.fault_notes))


def test_a_dropped_message_says_by_whom() -> None:
    machine = shaper("drop request name lossy")
    flows = talk()
    result = machine.process_message(flows.up, request(1), 0)
    assert (result.outputs, notes_of(result), machine.due()) == ([], ("lossy: dropped",), None)
    assert sent(machine.process_message(flows.down, reply(1), 0).outputs) == [reply(1)]
    assert machine.hit_counts == {"lossy": 1}


@pytest.mark.parametrize(
    ("fault", "note"),
    [
        ("pass", "passed"),
        ("burst=100%/0%", "dropped in a burst"),
        ("delay=1.5ms", "delayed by 1.5 ms"),
        ("duplicate", "duplicated"),
        ("duplicate=2", "duplicated 2 times"),
        ("reorder=2", "held back until 2 more messages have passed"),
        ("corrupt offset 3", "corrupted at byte 3"),
        ("truncate=4", f"cut to 4 of {len(reply(1))} bytes"),
        ("garbage=64", "replaced by 64 random bytes"),
        ("rewrite serial 7", "rewritten"),
        ("serial=2", "serial changed by +2"),
        ("serial=-2", "serial changed by -2"),
        ("executing=1.5s", "S_EXECUTING for 1500 ms"),
        ("close", "connection reset"),
        ("close=fin", "connection closed"),
        ("bandwidth=1kB/s", f"delayed by {len(reply(1))} ms"),
    ],
)
def test_every_fault_says_what_it_did(fault: str, note: str) -> None:
    flow = talk(Transport.TCP).down
    (said,) = notes_of(shaper(f"{fault} name x").process_message(flow, reply(1), HOUR))
    assert said == f"x: {note}"


def test_a_share_is_lost() -> None:
    flows = talk()
    lost = 2000 - len(through(shaper("loss=10%"), flows, *range(1, 2001)))
    assert 150 < lost < 250


def test_times_after_and_for_bound_a_fault() -> None:
    flows = talk()
    assert len(through(shaper("drop times 3"), flows, *range(1, 11))) == 7
    left = through(shaper("drop after 2ms for 5ms"), flows, *range(1, 11))
    assert [Frame(raw).serial for raw in left] == [1, 2, 8, 9, 10]


def test_a_fault_that_is_over_leaves_nothing_to_do() -> None:
    flows = talk()
    machine = shaper("drop times 1", "drop for 5ms")
    assert not machine.is_idle(0)
    machine.process_message(flows.up, request(1), 0)
    assert not machine.is_idle(4 * MS)
    assert machine.is_idle(5 * MS)


def test_a_condition_on_the_question_holds_for_its_answer() -> None:
    flows = talk()
    machine = shaper("drop reply if command == slvMove")
    machine.process_message(flows.up, request(1, "slvMove"), 0)
    machine.process_message(flows.up, request(2, "CurJnt"), 0)
    assert not passes(machine, flows.down, reply(1))
    assert passes(machine, flows.down, reply(2))


def test_a_fault_that_is_switched_on_again_knows_the_questions_of_before() -> None:
    flows = talk()
    machine = shaper("drop reply if command == slvMove", "delay=0 request")
    machine.set_enabled("drop", False)
    machine.process_message(flows.up, request(1, "slvMove"), 0)
    machine.set_enabled("drop", True)
    assert not passes(machine, flows.down, reply(1))


@pytest.mark.parametrize(
    "chain",
    [
        [(5, 0), (6, 5), (7, 5)],
        [(5, 5), (6, 5), (7, 5)],
        [(5, 0), (6, 5), (7, 6)],
        [(0xFFFF, 0), (1, 0xFFFF), (2, 0xFFFF)],
    ],
    ids=["seed", "own", "chain", "wrap"],
)
def test_a_try_is_known_in_every_convention(chain: list[tuple[int, int]]) -> None:
    for attempt in (1, 2, 3):
        flows = talk()
        machine = shaper(f"drop reply try {attempt}")
        passed = []
        for serial, reserved in chain:
            machine.process_message(flows.up, request(serial, reserved=reserved), 0)
            passed.append(passes(machine, flows.down, reply(serial)))
        assert passed == [attempt != number for number in (1, 2, 3)]


def test_a_delay_keeps_the_order_and_the_bytes() -> None:
    found = arrivals(shaper("delay=3ms"), talk().up, [request(1), request(2)])
    assert found == [(3 * MS, request(1)), (4 * MS, request(2))]


def test_datagrams_overtake_a_delayed_one_and_bytes_of_a_stream_do_not() -> None:
    for transport, order in ((Transport.UDP, [2, 1]), (Transport.TCP, [1, 2])):
        found = arrivals(shaper("delay=3ms times 1"), talk(transport).up, [request(1), request(2)])
        assert [Frame(raw).serial for _, raw in found] == order


@pytest.mark.parametrize("distribution", ["uniform", "normal", "pareto"])
def test_a_jitter_stays_around_the_delay(distribution: str) -> None:
    machine = shaper(f"delay=5ms±1ms distribution {distribution}")
    messages = [request(serial) for serial in range(1, 1001)]
    came = {raw: now for now, raw in arrivals(machine, talk().up, messages, every=20 * MS)}
    delays = [came[raw] - index * 20 * MS for index, raw in enumerate(messages)]
    assert min(delays) >= 0
    assert 4.9 * MS < statistics.mean(delays) < 5.1 * MS
    assert len(set(delays)) > 900
    if distribution == "uniform":
        assert 4 * MS <= min(delays) < 4.1 * MS
        assert 5.9 * MS < max(delays) <= 6 * MS
    if distribution == "normal":
        assert 0.9 * MS < statistics.stdev(delays) < 1.1 * MS
    if distribution == "pareto":  # few delays are long, and none is much shorter than the mean
        assert min(delays) >= 4.5 * MS
        assert max(delays) > 7 * MS


def test_a_delay_that_would_be_negative_is_none() -> None:
    assert passes(shaper("delay=0"), talk().up, request(1))
    machine = shaper("delay=0ms±1ms")
    at_once = sum(passes(machine, talk().up, request(serial)) for serial in range(100))
    assert 30 < at_once < 70


def test_copies_follow_their_message() -> None:
    found = arrivals(shaper("duplicate=2 time 1ms times 1"), talk().up, [request(1)])
    assert found == [(0, request(1)), (MS, request(1)), (2 * MS, request(1))]


def test_a_reordered_message_goes_behind_others() -> None:
    for others, order in ((2, [2, 3, 1, 4, 5]), (3, [2, 3, 4, 1, 5])):
        found = through(shaper(f"reorder={others} times 1"), talk(), 1, 2, 3, 4, 5)
        assert [Frame(raw).serial for raw in found] == order


def test_a_reordered_message_does_not_wait_without_end() -> None:
    found = arrivals(shaper("reorder=2 time 10ms"), talk().up, [request(1)])
    assert found == [(10 * MS, request(1))]


def test_corruption_turns_bits_over_where_it_is_told() -> None:
    raw = request(1)
    (found,) = sent(shaper("corrupt=1 offset 5").process_message(talk().up, raw, 0).outputs)
    assert len(found) == len(raw)
    different = [index for index, (one, other) in enumerate(zip(found, raw, strict=True)) if one != other]
    assert different == [5]
    assert (found[5] ^ raw[5]).bit_count() == 1


@pytest.mark.parametrize(("fault", "changed"), [("corrupt", 0xFFFFFF), ("corrupt offset 2", 0x0000FF)])
def test_corruption_can_hit_every_bit_where_it_is_told_and_no_other(fault: str, changed: int) -> None:
    machine, flows, hit = shaper(fault), talk(), 0
    for _ in range(300):
        (found,) = sent(machine.process_message(flows.up, bytes(3), 0).outputs)
        hit |= int.from_bytes(found)
    assert hit == changed


@pytest.mark.parametrize("fault", ["corrupt offset 3", "corrupt offset 9", "truncate=3", "truncate=9"])
def test_a_fault_beyond_the_end_of_a_message_leaves_it_alone(fault: str) -> None:
    machine = shaper(fault)
    assert passes(machine, talk().up, b"abc")
    assert list(machine.hit_counts.values()) == [0]


@pytest.mark.parametrize(("size", "some"), [(4, "0, 1, 2, 3"), (5, "0, 1, 2, 3, …")])
def test_a_note_names_the_first_four_corrupted_bytes(size: int, some: str) -> None:
    (note,) = shaper("corrupt=1000").process_message(talk().up, bytes(size), 0).fault_notes
    assert english(note) == f"corrupt: corrupted at byte {some}"


def test_a_message_is_cut() -> None:
    assert sent(shaper("truncate=20").process_message(talk().up, request(1), 0).outputs) == [request(1)[:20]]
    found = through(shaper("truncate"), talk(), *[1] * 500)
    assert {request(1)[:keep] for keep in range(len(request(1)))} == set(found)


def test_garbage_comes_in_place_of_a_reply() -> None:
    flows, machine = talk(), shaper("garbage=40")
    assert sent(machine.process_message(flows.up, request(1), 0).outputs) == [request(1)]
    (found,) = sent(machine.process_message(flows.down, reply(1), 0).outputs)
    assert len(found) == 40
    assert found != reply(1)


def test_an_answer_goes_back_under_the_serial_and_the_request_stays_away() -> None:
    flows, machine = talk(), shaper("answer=E_FAIL")
    taken = machine.process_message(flows.up, request(77), 0)
    (output,) = taken.outputs
    assert isinstance(output, SendBytes)
    assert output.flow.direction == flows.down.direction
    answer = Frame(output.data)
    assert (answer.serial, answer.code, answer.argc, answer.problems) == (77, E_FAIL, 0, ())
    assert (machine.due(), notes_of(taken)) == (None, ("answer: answered with E_FAIL",))


@pytest.mark.parametrize("fault", ["answer=E_FAIL", "executing=1s request"])
def test_an_answer_has_the_reserved_that_the_server_would_send(fault: str) -> None:
    for echoed in (0, 9):
        flows, machine = talk(), shaper(f"{fault} if serial == 11")
        machine.process_message(flows.up, request(10, reserved=9), 0)
        machine.process_message(flows.down, reply(10, reserved=echoed), 0)
        (output,) = machine.process_message(flows.up, request(11, reserved=9), 0).outputs
        assert isinstance(output, SendBytes)
        assert Frame(output.data).reserved == echoed


def test_a_client_that_comes_again_is_answered_as_a_new_one() -> None:
    flows, machine = talk(), shaper("answer=E_FAIL if serial == 11")
    machine.process_message(flows.up, request(10, reserved=9), 0)
    machine.process_message(flows.down, reply(10, reserved=9), 0)
    machine.close_conversation(flows.up.conversation)
    (output,) = machine.process_message(flows.up, request(11, reserved=9), 0).outputs
    assert isinstance(output, SendBytes)
    assert Frame(output.data).reserved == 0


def test_replies_to_a_client_that_comes_again_answer_no_earlier_request() -> None:
    for is_closed in (False, True):
        flows, machine = talk(), shaper("drop response if command == slvMove")
        assert passes(machine, flows.up, request(5))
        if is_closed:
            machine.close_conversation(flows.up.conversation)
        assert passes(machine, flows.down, reply(5)) is is_closed


def test_values_of_a_client_that_comes_again_are_no_step_from_its_earlier_values() -> None:
    for is_closed in (False, True):
        flows, machine = talk(), shaper("rewrite step arg[2][0]=1")
        assert passes(machine, flows.up, request(5, values=(0.0, 0.0)))
        if is_closed:
            machine.close_conversation(flows.up.conversation)
        assert passes(machine, flows.up, request(6, values=(50.0, 0.0))) is is_closed


def test_attempts_of_a_client_that_comes_again_are_counted_anew() -> None:
    for is_closed in (False, True):
        flows, machine = talk(), shaper("drop try 3")
        for serial, reserved in ((5, 0), (6, 5)):
            assert passes(machine, flows.up, request(serial, reserved=reserved))
        if is_closed:
            machine.close_conversation(flows.up.conversation)
        assert passes(machine, flows.up, request(7, reserved=6)) is is_closed


def test_messages_are_counted_from_one() -> None:
    left = through(shaper("drop if frame == 1", "drop if frame == 3"), talk(), *range(1, 6))
    assert [Frame(raw).serial for raw in left] == [2, 4, 5]


def test_a_reply_is_replaced_by_a_result() -> None:
    flows, machine = talk(), shaper("answer=E_FAIL reply")
    assert sent(machine.process_message(flows.up, request(3), 0).outputs) == [request(3)]
    taken = machine.process_message(flows.down, reply(3), 0)
    (raw,) = sent(taken.outputs)
    assert (Frame(raw).serial, Frame(raw).code, Frame(raw).argc) == (3, E_FAIL, 0)
    assert notes_of(taken) == ("answer: answer replaced by E_FAIL",)


def test_a_wrong_serial_changes_nothing_else() -> None:
    flows, machine = talk(), shaper("serial=2")
    (raw,) = sent(machine.process_message(flows.down, reply(0xFFFF), 0).outputs)
    assert raw == reply(1)


def test_notices_come_before_the_reply() -> None:
    flows, machine = talk(), shaper("executing=250ms every 100ms")
    found = arrivals(machine, flows.down, [reply(5)])
    assert [(now // MS, Frame(raw).serial) for now, raw in found] == [(0, 5), (100, 5), (200, 5), (250, 5)]
    assert [Frame(raw).code for _, raw in found] == [S_EXECUTING] * 3 + [0]
    assert found[-1][1] == reply(5)


@pytest.mark.parametrize("direction", ["request", "response"])
def test_notices_go_to_the_client(direction: str) -> None:
    flows, machine = talk(), shaper(f"executing=100ms {direction}")
    flow, raw = (flows.up, request(5)) if direction == "request" else (flows.down, reply(5))
    (output,) = machine.process_message(flow, raw, 0).outputs
    assert isinstance(output, SendBytes)
    assert output.flow.direction == "response"
    (later,) = machine.advance(100 * MS)
    assert later == SendBytes(flow, raw, output.fault_notes)


def test_a_connection_is_closed_and_udp_is_left_alone() -> None:
    flows = talk(Transport.TCP)
    (closing,) = shaper("close=fin").process_message(flows.up, request(1), 0).outputs
    assert isinstance(closing, CloseConnection)
    assert (closing.conversation, closing.how) == (flows.up.conversation, CloseMode.FIN)
    machine = shaper("close")
    assert sent(machine.process_message(talk().up, request(1), 0).outputs) == [request(1)]
    assert machine.hit_counts == {"close": 0}


def test_a_connection_is_closed_in_order_after_what_is_held_of_it_and_by_reset_at_once() -> None:
    for how, order in (
        ("fin", ["SendBytes", "SendBytes", "CloseConnection"]),
        ("reset", ["CloseConnection", "SendBytes", "SendBytes"]),
    ):
        flows, machine = (
            talk(Transport.TCP),
            shaper("delay=50ms if serial < 3", f"close={how} if serial == 3"),
        )
        outputs = [*machine.process_message(flows.up, request(1), 0).outputs]
        outputs += machine.process_message(flows.down, reply(2), 0).outputs
        outputs += machine.process_message(flows.up, request(3), MS).outputs
        outputs += machine.process_message(flows.up, request(4), MS).outputs
        outputs += machine.advance(50 * MS)
        assert [type(output).__name__ for output in outputs][:3] == order


def test_losses_come_in_bursts() -> None:
    serials = [Frame(raw).serial for raw in through(shaper("burst=1%/20%"), talk(), *range(1, 5001))]
    gaps = [b - a - 1 for a, b in itertools.pairwise(serials) if b - a > 1]
    assert 20 < len(gaps) < 80
    assert 3 < sum(gaps) / len(gaps) < 7.5
    assert passes(shaper("burst=0%/0%"), talk().up, request(1))


def test_a_narrow_line_takes_its_time() -> None:
    raw = request(1)
    machine = FaultInjector([read_fault(f"bandwidth={len(raw)}B/s".replace("B/s", "kB/s"))], seed=0, now=0)
    found = arrivals(machine, talk().up, [raw, raw, raw], every=0)
    assert [now for now, _ in found] == [MS, 2 * MS, 3 * MS]


def test_a_slow_line_takes_a_second_for_each_byte() -> None:
    found = arrivals(shaper("bandwidth=8bit/s"), talk().up, [bytes(1), bytes(60)], every=0)
    assert [now for now, _ in found] == [1000 * MS, 61_000 * MS]


def test_a_delayed_message_comes_to_a_narrow_line_late() -> None:
    machine = shaper("delay=5ms", "bandwidth=1kB/s queue 10")
    result = machine.process_message(talk().up, bytes(10), HOUR)
    assert (notes_of(result), machine.due()) == (
        ("delay: delayed by 5 ms", "bandwidth: delayed by 10 ms"),
        HOUR + 15 * MS,
    )


def test_a_full_queue_loses_datagrams_and_holds_a_stream() -> None:
    raw = request(1)
    for transport, left in ((Transport.UDP, 3), (Transport.TCP, 10)):
        machine = shaper(f"bandwidth={len(raw)}kB/s queue {3 * len(raw)}")
        assert len(arrivals(machine, talk(transport).up, [raw] * 10, every=0)) == left
    (note,) = notes_of(shaper("bandwidth=1kB/s queue 1").process_message(talk().up, raw, 0))
    assert note == "bandwidth: dropped, because the queue of the limited bandwidth is full"


def test_a_partition_loses_datagrams_and_holds_a_stream_until_it_ends() -> None:
    found = arrivals(shaper("partition for 10ms"), talk().up, [request(1)])
    assert found == []
    found = arrivals(shaper("partition for 10ms"), talk(Transport.TCP).up, [request(1), request(2)])
    assert found == [(10 * MS, request(1)), (10 * MS, request(2))]


@pytest.mark.parametrize(
    ("transport", "fault", "note"),
    [
        (Transport.UDP, "partition for 1s", "partition: dropped"),
        (Transport.TCP, "partition", "partition: dropped"),
        (Transport.TCP, "partition for 1s", "partition: held"),
    ],
)
def test_a_partition_says_what_became_of_a_message(transport: Transport, fault: str, note: str) -> None:
    result = shaper(fault).process_message(talk(transport).up, request(1), 0)
    (said,) = notes_of(result)
    assert said.startswith(note)


def test_a_half_open_conversation_is_dead_both_ways_and_others_live() -> None:
    flows, other = talk(Transport.TCP), talk(Transport.TCP, Endpoint("10.0.0.3", 5))
    machine = shaper("half-open times 1 if command == slvMove")
    assert not machine.holds(flows.up)
    assert not passes(machine, flows.up, request(1))
    taken = machine.process_message(flows.down, reply(1), 0)
    assert taken.outputs == []
    assert notes_of(taken) == ("half-open: dropped, because the conversation is half-open",)
    assert passes(machine, other.up, request(1))
    assert machine.holds(flows.down)
    assert not machine.passes_close(flows.up.conversation)
    assert not machine.holds(other.up)
    machine.close_conversation(flows.up.conversation)
    assert machine.is_idle(0)


def test_pass_saves_from_what_comes_after_it() -> None:
    flows = talk()
    machine = shaper("pass if command == slvMove", "drop")
    assert passes(machine, flows.up, request(1, "slvMove"))
    assert not passes(machine, flows.up, request(2, "CurJnt"))
    assert machine.hit_counts == {"pass": 1, "drop": 1}


def test_faults_are_added_switched_and_removed() -> None:
    flows, machine = talk(), shaper()
    assert machine.add(read_fault("drop"), 0) == "drop"
    assert machine.add(read_fault("drop"), 0) == "drop-2"
    with pytest.raises(ValueError, match="a fault named x exists already"):
        [machine.add(read_fault("drop name x"), 0) for _ in range(2)]
    for name in ("drop", "drop-2", "x"):
        assert notes_of(machine.process_message(flows.up, request(1), 0)) == (f"{name}: dropped",)
        machine.set_enabled(name, False)
    assert passes(machine, flows.up, request(1))
    machine.set_enabled("x", True)
    assert not passes(machine, flows.up, request(1))
    machine.remove("x")
    assert passes(machine, flows.up, request(1))
    with pytest.raises(KeyError):
        machine.remove("x")


def test_what_is_held_of_a_conversation_that_is_over_is_lost() -> None:
    flows, other, machine = talk(), talk(), shaper("delay=3ms", "reorder")
    machine.process_message(flows.up, request(1), 0)
    machine.process_message(other.up, request(2), 0)
    assert [machine.holds(each) for each in (*flows, *other)] == [True, False, True, False]
    machine.close_conversation(flows.up.conversation)
    assert [data for _, data in run_dry(machine, 0)] == [request(2)]


def test_no_more_copies_are_held_than_fit() -> None:
    raw = bytes(60_000)
    flows, machine = talk(), shaper("duplicate=1000 time 10s")
    while not machine.is_full:
        machine.process_message(flows.up, raw, 0)
    taken = machine.process_message(flows.up, raw, 0)
    assert notes_of(taken) == (
        "duplicate: duplicated 1000 times",
        "copies dropped, because too many messages are held",
    )
    assert [output.data for output in taken.outputs if isinstance(output, SendBytes)] == [raw]


def test_no_more_is_held_than_fits() -> None:
    raw = bytes(60_000)
    flows, stream = talk(), talk(Transport.TCP)
    machine = shaper("delay=10s")
    held = 0
    while not machine.is_full:
        machine.process_message(flows.up, raw, 0)
        held += 1
    taken = machine.process_message(flows.up, raw, 0)
    assert notes_of(taken) == ("delay: delayed by 10000 ms", "dropped, because too many messages are held")
    assert taken.outputs == []
    machine.process_message(stream.up, raw, 0)
    count = len(run_dry(machine, 0))
    assert count == held + 1
    assert MAX_WAITING <= count * (len(raw) + 400) < MAX_WAITING + 300_000
    assert not machine.is_full
    machine.process_message(flows.up, raw, 20_000 * MS)
    machine.close_conversation(flows.up.conversation)
    assert not machine.is_full


STEPS = st.lists(
    st.tuples(
        st.booleans(),
        st.integers(0, 3 * MS),
        st.binary(min_size=1, max_size=60) | st.builds(request, st.integers(0, 9)),
    ),
    max_size=30,
)
FAULTS = st.lists(
    st.sampled_from(
        [
            "loss=30%",
            "delay=3ms±2ms",
            "duplicate 20%",
            "reorder=2 30%",
            "corrupt=3 50%",
            "truncate 30%",
            "burst=20%/30%",
            "garbage 20%",
            "serial 40%",
            "answer=E_FAIL 30%",
            "executing=5ms every 2ms 30%",
            "bandwidth=64kB/s",
            "drop try 2",
            "partition after 5ms for 10ms",
            "close 5%",
            "half-open 2%",
            "rewrite set arg[2][0]=5 serial 3",
            "drop if length > 40 and command == slvMove",
        ]
    ),
    max_size=5,
)


def history(
    faults: list[str], seed: int, steps: list[tuple[bool, int, bytes]], transport: Transport
) -> list[object]:
    """Play steps; give all decisions and outputs."""
    flows, machine, now = talk(transport), shaper(*faults, seed=seed), 0
    notices: list[object] = []
    for up, later, data in steps:
        now += later
        taken = machine.process_message(flows.up if up else flows.down, data, now)
        notices.append((taken.fault_notes, sent(taken.outputs), len(closed(taken.outputs))))
    return [*notices, run_dry(machine, now), machine.hit_counts]


@given(FAULTS, st.integers(), STEPS, st.sampled_from([Transport.UDP, Transport.TCP]))
def test_the_same_seed_and_traffic_give_the_same(
    faults: list[str], seed: int, steps: list[tuple[bool, int, bytes]], transport: Transport
) -> None:
    assert history(faults, seed, steps, transport) == history(faults, seed, steps, transport)


@given(st.integers(), STEPS)
def test_one_more_fault_changes_nothing_in_what_others_decide(
    seed: int, steps: list[tuple[bool, int, bytes]]
) -> None:
    flows, alone, beside = (
        talk(),
        shaper("delay=3ms±2ms 50%", seed=seed),
        shaper("loss=50%", "delay=3ms±2ms 50%", seed=seed),
    )
    now = 0
    for up, later, data in steps:
        now += later
        flow = flows.up if up else flows.down
        first, second = alone.process_message(flow, data, now), beside.process_message(flow, data, now)
        assert notes_of(second) in (("drop: dropped",), notes_of(first))


@given(STEPS, st.sampled_from([Transport.UDP, Transport.TCP]))
def test_faults_that_never_strike_pass_everything_at_once_and_in_order(
    steps: list[tuple[bool, int, bytes]], transport: Transport
) -> None:
    flows, now = talk(transport), 0
    machine = shaper("loss=0%", "drop if serial == 70000", "delay=3ms after 1s", "drop try 9")
    for up, later, data in steps:
        now += later
        taken = machine.process_message(flows.up if up else flows.down, data, now)
        assert sent(taken.outputs) == [data]
        assert machine.due() is None


@given(st.integers(), STEPS, st.sampled_from([Transport.UDP, Transport.TCP]))
def test_nothing_is_lost_without_a_decision(
    seed: int, steps: list[tuple[bool, int, bytes]], transport: Transport
) -> None:
    flows, now = talk(transport), 0
    machine = shaper("loss=30%", "delay=3ms±2ms", "reorder=2 30%", seed=seed)
    expected, found = [], []
    for up, later, data in steps:
        now += later
        taken = machine.process_message(flows.up if up else flows.down, data, now)
        found += sent(taken.outputs)
        if "drop: dropped" not in notes_of(taken):
            expected.append(data)
    found += [data for _, data in run_dry(machine, now)]
    assert sorted(found) == sorted(expected)


@given(FAULTS, st.integers(), STEPS)
def test_a_stream_keeps_its_order_under_delays(
    faults: list[str], seed: int, steps: list[tuple[bool, int, bytes]]
) -> None:
    flows, machine, now = talk(Transport.TCP), shaper("delay=3ms±2ms", "bandwidth=64kB/s", seed=seed), 0
    found = []
    for _, later, data in steps:
        now += later
        found += sent(machine.process_message(flows.up, data, now).outputs)
    assert found + [data for _, data in run_dry(machine, now)] == [data for _, _, data in steps]


@pytest.mark.parametrize("transport", [Transport.UDP, Transport.TCP])
def test_what_is_held_of_one_direction_can_be_taken_back_in_its_order(transport: Transport) -> None:
    machine, flows = (
        shaper("delay=20ms if serial == 1", "delay=10ms", "reorder if serial == 4"),
        talk(transport),
    )
    for serial in (1, 2, 3, 4):
        machine.process_message(flows.up, request(serial), 0)
    machine.process_message(flows.down, reply(1), 0)
    in_order = (1, 2, 3, 4) if transport is Transport.TCP else (2, 3, 1, 4)
    assert machine.pop_held(flows.up) == [*map(request, in_order)]
    assert machine.pop_held(flows.up) == []
    assert not machine.holds(flows.up)
    assert [data for _, data in run_dry(machine, 0)] == [reply(1)]


@pytest.mark.parametrize("is_closed", [False, True])
@pytest.mark.parametrize("fault", ["delay=20ms", "reorder"])
def test_what_was_taken_back_or_closed_holds_nothing_up_and_comes_no_more(
    fault: str, is_closed: bool
) -> None:
    machine, flows, other = (
        shaper("delay=9ms if serial == 9", f"{fault} if serial == 1"),
        talk(Transport.TCP),
        talk(),
    )
    machine.process_message(other.up, request(9), 0)
    machine.process_message(flows.up, request(1), 0)
    if is_closed:
        machine.close_conversation(flows.up.conversation)
    else:
        assert machine.pop_held(flows.up) == [request(1)]
    assert passes(machine, flows.up, request(2))
    assert passes(machine, flows.up, request(3))
    assert run_dry(machine, 0) == [(9 * MS, request(9))]


@pytest.mark.parametrize("is_closed", [False, True])
def test_the_rest_keeps_its_times_after_some_was_taken_back_or_closed(is_closed: bool) -> None:
    delays = {1: 1, 2: 10, 3: 2, 4: 11, 5: 12, 6: 3}
    machine = shaper(*(f"delay={delay}ms if serial == {serial}" for serial, delay in delays.items()))
    gone, kept = talk(client=Endpoint("10.0.0.3", 5)), talk()
    for serial in delays:
        machine.process_message((gone if serial in (1, 3) else kept).up, request(serial), 0)
    if is_closed:
        machine.close_conversation(gone.up.conversation)
    else:
        machine.pop_held(gone.up)
    assert run_dry(machine, 0) == [(delays[serial] * MS, request(serial)) for serial in (6, 2, 4, 5)]


@pytest.mark.parametrize("is_closed", [False, True])
def test_what_was_taken_back_or_closed_makes_room(is_closed: bool) -> None:
    machine, flows = shaper("delay=10s"), talk()
    while not machine.is_full:
        machine.process_message(flows.up, bytes(60_000), 0)
    if is_closed:
        machine.close_conversation(flows.up.conversation)
    else:
        machine.pop_held(flows.up)
    assert not machine.is_full


def test_nothing_can_be_taken_back_from_a_half_open_conversation() -> None:
    machine, flows = shaper("delay=20ms if serial == 1", "half-open if serial == 2"), talk(Transport.TCP)
    machine.process_message(flows.up, request(1), 0)
    machine.process_message(flows.up, request(2), 0)
    assert machine.pop_held(flows.up) == []


@pytest.mark.parametrize(
    ("fault", "times"),
    [
        ("close", [25]),
        ("duplicate time 1ms times 1", [25, 26]),
        ("reorder=2 time 10ms", [35]),
        ("executing=4ms every 2ms", [25, 27, 29]),
    ],
)
def test_a_delay_adds_to_what_another_fault_does(fault: str, times: list[int]) -> None:
    machine, flow, found = shaper("delay=25ms", fault), talk(Transport.TCP).down, []
    outputs = machine.process_message(flow, reply(1), HOUR).outputs
    found += [0] * len(outputs)
    while (due := machine.due()) is not None:
        found += [(due - HOUR) // MS] * len(machine.advance(due))
    assert found == times


def test_copies_that_need_not_wait_are_sent_when_too_much_is_held() -> None:
    raw, flows = bytes(60_000), talk()
    machine = shaper("duplicate=1000 time 10s", "duplicate=2")
    while not machine.is_full:
        machine.process_message(flows.up, raw, 0)
    assert sent(machine.process_message(flows.up, raw, 0).outputs) == [raw] * 3


def test_a_fault_gets_a_message_as_earlier_faults_left_it() -> None:
    machine = shaper("rewrite serial 7", "rewrite set arg[1]=Other")
    assert sent(machine.process_message(talk().up, request(1), 0).outputs) == [request(7, "Other")]


def test_conditions_see_the_time_of_day() -> None:
    fault = read_fault('drop if time >= "1970-01-01 00:00:13" and time < "1970-01-01 00:00:14"')
    machine = FaultInjector([fault], now=0, epoch=10_000 * MS)
    left = [machine.process_message(talk().up, request(1), second * 1000 * MS) for second in range(5)]
    assert [len(sent(result.outputs)) for result in left] == [1, 1, 1, 0, 1]
