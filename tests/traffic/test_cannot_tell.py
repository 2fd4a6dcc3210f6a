"""A verdict is definite wherever the capture decides, and "cannot tell" only where it does not.

`possible_worlds` says what a world may be. The property compares what the package said when it settled a call
with all worlds of the capture up to then. Later frames are of no use to a reader of live traffic.

Vague verdicts are `cannot tell`, `not captured` and `capture ended`. `not followed` depends on memory, not on
the capture. `cannot tell` is right only if each of `request lost`, `reply lost` and `reply late` is wrong in
some world. `not captured` is right only if the client has a reply, or still waits, in some world. `capture
ended` is right only if the client still waits in some world. A definite verdict must be right in some world;
`test_captured_sessions` checks that it is the truth.

A client that begins its next call within 2 ms after a request does not wait for replies. Such a client may
accept the reply to the earlier call at any later time. So only the next request of a client shows that the
client no longer waits, and only if this request comes later than that.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Malformed
from bcapscope.traffic.call import Call, FrameRole
from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.capture_point import CapturePoint
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.joining.joined_observation import JoinedObservation, sighting_numbers
from bcapscope.traffic.joining.joiner import Joiner
from bcapscope.traffic.observation import Direction, Observation, Transport
from bcapscope.traffic.pipeline import Pipeline, PipelineSubscriber
from bcapscope.traffic.tracker import Tracker
from tests.traffic.capture_evidence import SHORTEST_TIMEOUT, Evidence
from tests.traffic.captured_sessions import CapturedSession, KnownCall, Surroundings
from tests.traffic.playbook import MS, POSE, START, Script, calls_of, slv_move
from tests.traffic.possible_worlds import Claim, PossibleWorlds
from tests.traffic.sessions import Capture, Profile, Session
from tests.traffic.test_captured_sessions import SEEDS, place_of

AROUND = st.builds(
    Surroundings,
    convention=st.sampled_from(["seed", "own", "chain"]),
    place=st.sampled_from([0.0, 0.1, 0.5, 0.9, 1.0]),
    up=st.sampled_from([20, 300, 1500, 5000]),
    down=st.sampled_from([20, 300, 1500, 5000]),
    timeout=st.sampled_from([2, 8, 16, 50]),
    tries=st.integers(2, 5),
    loss=st.sampled_from([0.0, 0.05, 0.3]),
    missed=st.sampled_from([0.0, 0.1, 0.4]),
    work=st.sampled_from([50, 400, 7000]),
    slow=st.sampled_from([0.0, 0.1, 0.4]),
    notices=st.sampled_from([0, 0, 1, 7]),
    holds=st.booleans(),
)
CALLS = 16
CLAIMS = {
    CallVerdict.REQUEST_LOST: Claim.REQUEST_LOST,
    CallVerdict.REPLY_LOST: Claim.REPLY_LOST,
    CallVerdict.REPLY_LATE: Claim.REPLY_LATE,
}


class Judged(NamedTuple):
    """A call, with the evidence before the frame at which it was settled, and up to that frame."""

    call: Call
    before: Evidence
    known: Evidence


class Witness(PipelineSubscriber):
    """Keeps each call, with the number of frames that had been read before the last one, and with it."""

    def __init__(self, frames: int) -> None:
        self.read: list[int] = []
        self.calls: list[tuple[Call, int, int, int]] = []
        self.latest = 0
        self.has_ended = False
        self._frames = frames
        self._before = 0

    def on_frame(self, observation: Observation) -> None:
        self._before = len(self.read)
        self.read.extend(sighting_numbers(observation))

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        count = len(self.read)
        before = count if self.has_ended and count == self._frames else self._before
        self.calls.append((call, self.latest, before, count))


def judged(session: CapturedSession, place: CapturePoint | None) -> Iterator[Judged]:
    """Yield each call of the session with the evidence for its verdict."""
    witness = Witness(len(session.observations))
    is_double = len(session.around.places) > 1
    pipeline = Pipeline(witness, joiner=Joiner() if is_double else None, taken_at=place)
    for observation in session.observations:
        witness.latest = observation.time
        pipeline.add(observation)
    witness.has_ended = True
    pipeline.finish()
    for call, latest, *counts in witness.calls:
        before, known = (
            Evidence.of(
                [session.seen[number - 1] for number in sorted(witness.read[:count])],
                len(session.around.places),
                place and place.value,
                latest,
            )
            for count in counts
        )
        yield Judged(call, before, known)


def check(judged: Judged, truth: KnownCall) -> None:
    call, before, known = judged
    serial = call.request.item.serial
    at_verdict, at_frame = PossibleWorlds(before), PossibleWorlds(known)
    told = f"{call} {call.outcome}, {call.verdict}; {known.told(serial)}; {truth.sent}, {truth.accepted}"
    accepted = truth.accepted if truth.accepted in known.replies else None
    assert any(world.accepted == accepted for world in at_frame.worlds(serial)), f"no true world: {told}"
    if call.verdict in CLAIMS:
        claim = CLAIMS[call.verdict]
        assert any(claim in world.claims for world in at_frame.worlds(serial)), f"wrong: {told}"
    elif call.verdict is CallVerdict.CANNOT_TELL:
        for claim in CLAIMS.values():
            assert any(at_verdict.worlds(serial, without=claim)), f"surely {claim.value}: {told}"
    if call.outcome is Outcome.UNANSWERED:
        assert any(Claim.UNANSWERED in world.claims for world in at_frame.worlds(serial)), f"wrong: {told}"
    elif call.outcome is Outcome.CAPTURE_ENDED:
        assert any(Claim.WAITING in world.claims for world in at_verdict.worlds(serial)), (
            f"surely ended: {told}"
        )
    elif call.outcome is Outcome.NOT_CAPTURED and before.replies:
        assert any(at_verdict.worlds(serial, without=Claim.UNANSWERED)), f"surely unanswered: {told}"


@given(AROUND, SEEDS, st.booleans())
def test_one_place(around: Surroundings, seed: int, named: bool) -> None:
    session = CapturedSession(around, CALLS, seed)
    for each in judged(session, place_of(around) if named else None):
        check(each, session.by_serial[each.call.request.item.serial])


@given(AROUND, SEEDS, st.sampled_from([0.3, 1.0]), st.booleans())
def test_two_places(around: Surroundings, seed: int, width: float, is_relayed: bool) -> None:
    """The two places may be the legs of a proxy, which loses and delays frames between them."""
    far = around.place + width * (1 - around.place)
    if far > around.place:
        around = replace(around, far_place=far, missed=0.0, is_relayed=is_relayed)
    session = CapturedSession(around, CALLS, seed)
    for each in judged(session, None):
        check(each, session.by_serial[each.call.request.item.serial])


@given(AROUND, SEEDS)
def test_a_recording_of_a_proxy_shows_each_loss_in_the_proxy(around: Surroundings, seed: int) -> None:
    """The proxy loses and delays frames, and nothing else does.

    Frames after the last answered call may still be in the proxy when the recording ends.
    """
    around = replace(around, place=0.0, far_place=1.0, missed=0.0, is_relayed=True)
    session = CapturedSession(around, CALLS, seed)
    vague, answered = list[int](), 0
    for each in judged(session, None):
        check(each, session.by_serial[each.call.request.item.serial])
        reply = each.call.reply
        if isinstance(reply, JoinedObservation) and reply.at_client is not None:
            answered = max(answered, each.call.number)
        if each.call.verdict in (CallVerdict.CANNOT_TELL, CallVerdict.NOT_CAPTURED):
            vague.append(each.call.number)
    assert all(number > answered for number in vague)


@given(st.sampled_from(["tcp0", "tcp1", "same"]), st.sampled_from([0.0, 0.1]), SEEDS)
def test_a_stream_loses_nothing_that_a_verdict_could_leave_open(
    convention: str, slow: float, seed: int
) -> None:
    session = Session(Profile(convention=convention, timeout=5, slow=slow), CALLS, seed)
    capture = Capture([(session.profile, session.records)])
    pairing = Tracker()
    settled = [item for seen in capture.observations for item in pairing.observe(seen)]
    for call in calls_of([*settled, *pairing.close()]):
        assert call.verdict not in (CallVerdict.CANNOT_TELL, CallVerdict.NOT_CAPTURED)
        times = [seen.time for seen in capture.observations if seen.flow.direction is Direction.REQUEST]
        later = [time for time in times if time >= waited_since(call) + SHORTEST_TIMEOUT]
        assert call.verdict is not CallVerdict.CAPTURE_ENDED or not later


def waited_since(call: Call) -> int:
    return max(seen.time for role, seen in call.frames if role in (FrameRole.REQUEST, FrameRole.NOTICE))


@given(st.lists(st.tuples(*[st.booleans()] * 3, st.sampled_from([0.5, 1.5, 3.0, 20.0])), max_size=12))
def test_a_gap_leaves_open_only_the_calls_whose_reply_it_may_hold(
    calls: list[tuple[bool, bool, bool, float]],
) -> None:
    """Each tuple says whether the reply was captured, and whether it and its notice left a gap."""
    script = Script()
    client = script.client(transport=Transport.TCP)
    at, gaps, replies = 0.0, list[float](), dict[int, float]()
    for serial, (is_captured, leaves_gap, is_first_gap, pause) in enumerate(calls, 1):
        client.ask(at, serial, 0, slv_move(float(serial)))
        if is_first_gap:
            gaps.append(at + 0.1)
            client.see(gaps[-1], Direction.RESPONSE, Malformed(b"", (), 16))
        if is_captured:
            replies[serial] = at + 0.2
            client.reply(at + 0.2, serial, 0, 0, POSE)
        elif leaves_gap:
            gaps.append(at + 0.2)
            client.see(gaps[-1], Direction.RESPONSE, Malformed(b"", (), 44))
        at += pause
    sent = [(seen.time - START) / MS for seen in script.seen if seen.flow.direction is Direction.REQUEST]
    for call in calls_of(script.track()):
        serial, asked = call.request.item.serial, (call.request.time - START) / MS
        until = min((time for other, time in replies.items() if other > serial), default=at)
        may_be_in_gap = any(asked < time < until for time in gaps)
        next_at = min((time for time in sent if time > asked), default=asked)
        gone_on = next_at - asked >= SHORTEST_TIMEOUT / MS
        if serial in replies:
            assert call.outcome is Outcome.ANSWERED
        elif may_be_in_gap:
            assert call.outcome is Outcome.NOT_CAPTURED
        elif gaps or replies:
            assert call.outcome is Outcome.UNANSWERED or not gone_on
