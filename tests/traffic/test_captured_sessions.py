"""Each verdict is what really happened, or "cannot tell", wherever the capture was taken."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Frame, Malformed
from bcapscope.traffic.call import Call, FrameObservation
from bcapscope.traffic.call_verdict import CallVerdict
from bcapscope.traffic.capture_point import CapturePoint
from bcapscope.traffic.observation import Direction, Observation, Transport
from bcapscope.traffic.tracker import Tracker
from tests.traffic.captured_sessions import CapturedSession, KnownCall, Reply, Surroundings
from tests.traffic.playbook import POSE, Script, calls_of, slv_move, strays_of

SURROUNDINGS = st.builds(
    Surroundings,
    convention=st.sampled_from(["seed", "own", "chain"]),
    place=st.sampled_from([0.0, 0.1, 0.5, 0.9, 1.0]),
    up=st.sampled_from([20, 300, 1500, 5000]),
    down=st.sampled_from([20, 300, 1500, 5000]),
    timeout=st.sampled_from([2, 8, 16, 50]),
    tries=st.integers(2, 8),
    loss=st.sampled_from([0.0, 0.05, 0.3]),
    missed=st.sampled_from([0.0, 0.1, 0.4]),
    work=st.sampled_from([50, 400, 7000]),
    slow=st.sampled_from([0.0, 0.1, 0.4]),
    notices=st.sampled_from([0, 0, 1, 7]),
    holds=st.booleans(),
)
SEEDS = st.integers(0, 2**32)
CALLS = 40


def place_of(around: Surroundings) -> CapturePoint:
    named = {0.0: CapturePoint.CLIENT, 1.0: CapturePoint.CONTROLLER}
    return named.get(around.place, CapturePoint.BETWEEN)


def is_late(call: KnownCall, reply: Reply, seen: FrameObservation, around: Surroundings) -> bool:
    """Return whether a reply reached the client after it had given up the attempt, or would have at best."""
    given_up = call.given_up_at(reply.attempt)
    came = reply.came or seen.time + round(around.down * 1000 * around.place)
    return given_up is not None and came >= given_up


def first_request(observations: list[Observation]) -> int:
    """Return the frame number of the first request that was captured."""
    requests = (seen.number for seen in observations if isinstance(seen.item, Frame))
    numbers = [number for number in requests if observations[number - 1].flow.direction == "request"]
    return min(numbers, default=len(observations) + 1)


def check(call: Call, known: KnownCall, around: Surroundings) -> None:
    """Compare a call with what really happened to it."""
    replies = dict(known.replies)
    verdict = call.verdict
    told = f"{call} {call.outcome}, {verdict}; {known}"
    if verdict is CallVerdict.UNANSWERED:
        assert known.accepted is None, told
    elif verdict is CallVerdict.REPLY_LATE:
        assert any(is_late(known, replies[seen.number], seen, around) for seen in call.late_replies), told
        if call.outcome == "unanswered":
            assert known.accepted is None, told
    elif verdict is CallVerdict.REPLY_LOST:
        seen = [replies.get(each.number) for each in (*call.lost_replies, *call.stray_replies)]
        is_noticed = bool(call.notices) or None in seen
        lost = known.answered if is_noticed else [reply for reply in seen if reply is not None]
        assert any(reply.came is None for reply in lost), told
    elif verdict is CallVerdict.REQUEST_LOST:
        received = {reply.attempt for reply in known.answered}
        assert any(serial not in received for serial, _ in known.sent), told
    else:
        assert verdict is not CallVerdict.EXECUTED_TWICE, told
    if call.sure_until is not None:
        return
    sent = [serial for serial, _ in known.sent]
    last = sent.index(call.last_attempt.item.serial)
    first = sent.index(call.serials[0])
    if not call.first_attempt_seen:
        first = sent.index(call.request.item.reserved) + 1
    assert set(call.unseen_serials) <= set(sent), told
    assert len(call.attempts) + call.unseen_retries == last - first + 1, told


@given(SURROUNDINGS, SEEDS, st.booleans())
def test_a_verdict_is_true_or_cannot_be_told(around: Surroundings, seed: int, named: bool) -> None:
    session = CapturedSession(around, CALLS, seed)
    tracker = Tracker(place_of(around) if named else None)
    settled = [item for seen in session.observations for item in tracker.observe(seen)]
    settled += tracker.close()
    for call in calls_of(settled):
        known = session.by_serial[call.request.item.serial]
        assert call.sure_until is not None or all(
            session.by_serial[serial] is known for serial in call.serials
        )
        check(call, known, around)
    first = first_request(session.observations)
    for stray in strays_of(settled):
        assert stray.request_missed or stray.call_number is not None or stray.observation.number < first


@given(st.lists(st.tuples(st.booleans(), st.booleans(), st.booleans(), st.integers(1, 30)), max_size=30))
def test_a_gap_in_a_stream_is_held_against_nobody(calls: list[tuple[bool, bool, bool, int]]) -> None:
    """A client on TCP gets a reply to each call. The capture lacks requests and replies, and says so."""
    script = Script()
    client = script.client(transport=Transport.TCP)
    at = 0.0
    lacks = dict.fromkeys(Direction, False)
    for number, (asked, answered, soon, takes) in enumerate(calls, 1):
        for direction, is_captured in ((Direction.REQUEST, asked), (Direction.RESPONSE, answered)):
            at += takes if direction is Direction.RESPONSE else 0.1 if soon else 20
            if not is_captured:
                lacks[direction] = True
                continue
            if lacks[direction]:
                client.see(at, direction, Malformed(b"", (), 44))
                lacks[direction] = False
            if direction is Direction.REQUEST:
                client.ask(at, number, 0, slv_move(float(number)))
            else:
                client.reply(at, number, 0, 0, POSE)
    for direction in Direction:
        if lacks[direction]:  # the acknowledgements show it at the end
            client.see(at + 1, direction, Malformed(b"", (), 44))
    settled = script.track()
    for call in calls_of(settled):
        expected = "answered" if calls[call.request.item.serial - 1][1] else "not captured"
        assert call.verdict.value in (expected, "capture ended"), f"{call} {call.verdict}"
    first = first_request(script.seen)
    assert all(stray.request_missed or stray.observation.number < first for stray in strays_of(settled))
