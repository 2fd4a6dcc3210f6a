"""The tracker against sessions of which everything is known: it finds exactly what was done."""

from __future__ import annotations

import re

from hypothesis import example, given, settings
from hypothesis import strategies as st

from bcapscope.traffic.call import Call, PairingResult
from bcapscope.traffic.call_verdict import CallVerdict
from bcapscope.traffic.client_timeout import SHORTEST_SILENCE_NS, SHORTEST_TIMEOUT_NS
from bcapscope.traffic.observation import Direction, Transport
from bcapscope.traffic.pairing_windows import COPIES_WITHIN_NS, LATE_WITHIN_NS
from bcapscope.traffic.reserved_field import ReservedConvention
from bcapscope.traffic.tracker import Tracker
from tests.traffic.playbook import MS, Script, calls_of, i4, strays_of, summary
from tests.traffic.sessions import Capture, Profile, Record, Session

PROFILES = st.builds(
    Profile,
    convention=st.sampled_from(["seed", "own", "chain", "tcp0", "tcp1", "same"]),
    first_serial=st.sampled_from([1, 1000, 65520, 65533, 65535]),
    through_zero=st.booleans(),
    timeout=st.sampled_from([2, 5, 20]),
    tries=st.integers(1, 7),
    loss=st.sampled_from([0.0, 0.1, 0.5]),
    copies=st.sampled_from([0.0, 0.2]),
    delay=st.sampled_from([0.5, 4.0, 39.0]),
    slow=st.sampled_from([0.0, 0.1]),
    restart=st.sampled_from([0.0, 0.1]),
    forgetful=st.booleans(),
    echo=st.booleans(),
)
SEEDS = st.integers(0, 2**32)


def told(records: dict[int, Record]) -> list[str]:
    """Tell each call of a client in one line, as `summary` does, from what is known about the session."""
    calls = sorted({record.call for record in records.values()})
    by_call = {call: {n: r for n, r in records.items() if r.call == call} for call in calls}
    end = max((r.time for r in records.values()), default=0)
    lines: list[str] = []
    passed = False  # a later call was answered, and longer ago than the network changes the order
    for call in reversed(calls):
        later = [r.time for r in records.values() if r.call > call and r.kind == "request"]
        lines.append(_line(by_call[call], min(later, default=None), passed))
        answered = [records[int(word[1:])].time for word in lines[-1].split() if re.fullmatch(r"<\d+", word)]
        passed = passed or any(time < end - COPIES_WITHIN_NS for time in answered)
    return lines[::-1]


def rejected(line: str) -> str:
    """Tell a call in one line, as `told` does, where its client had given up before the reply came."""
    words = line.replace(" <", " late<").rpartition(" answered, ")
    verdict = words[2] if words[2] == "executed twice" else "reply late"
    return f"{words[0]} unanswered, {verdict}"


def _line(records: dict[int, Record], next_call: int | None, passed: bool) -> str:
    known: set[bytes] = set()
    words: list[str] = []
    roles: list[tuple[str, Record]] = []
    waiting_since = last = 0
    gone_on = accepted = False
    for number, record in records.items():
        if next_call is not None and record.time >= next_call and not accepted:
            gone_on = gone_on or next_call - waiting_since >= SHORTEST_TIMEOUT_NS
        role = "<"
        if record.kind == "notice":
            role = "..."
        elif record.raw in known:
            role = "="
        elif record.kind == "request":
            role = ">>" if record.attempt else ">"
            last = record.attempt
        elif accepted or gone_on or record.attempt != last:
            role = "late<"
        known.add(record.raw)
        if role in (">", ">>") or (role == "..." and record.attempt == last):
            waiting_since = record.time  # a client discards a notice that answers an earlier attempt
        accepted = accepted or role == "<"
        words.append(f"{role}{number}")
        roles.append((role, record))
    if next_call is not None and not accepted:
        gone_on = gone_on or next_call - waiting_since >= SHORTEST_TIMEOUT_NS
    outcome = "answered" if accepted else "unanswered" if gone_on or passed else "capture_ended"
    return f"{' '.join(words)} {outcome}, {_verdict(roles, outcome)}"


def _verdict(roles: list[tuple[str, Record]], outcome: str) -> str:
    results = {record.raw[9:] for role, record in roles if role in ("<", "late<")}
    if len(results) > 1:
        return "executed twice"
    if any(role == "late<" for role, _ in roles):
        return "reply late"
    tries = sum(role in (">", ">>") for role, _ in roles)
    if outcome != "answered" or tries == 1:
        return outcome.replace("_", " ")
    (answered,) = [record.attempt for role, record in roles if role == "<"]
    noticed = {record.attempt for role, record in roles if role == "..."}
    if noticed - {answered}:
        return "reply lost"
    return "request lost" if noticed else "cannot tell"


def track(capture: Capture) -> list[PairingResult]:
    tracker = Tracker()
    settled = [item for seen in capture.observations for item in tracker.observe(seen)]
    return [*settled, *tracker.close()]


def calls_by_client(capture: Capture, settled: list[PairingResult]) -> list[list[Call]]:
    return [
        [call for call in calls_of(settled) if call.conversation is conversation]
        for conversation in capture.conversations
    ]


@example(
    [
        Profile("seed", 1, False, 20, 5, 0.5, 0.0, 39.0, 0.1, 0.0, False, False),
        Profile("seed", 1, False, 2, 2, 0.5, 0.0, 4.0, 0.1, 0.0, True, False),
    ],
    131072,
)
# S_EXECUTING for an earlier attempt comes shortly before the next call.
@example(
    [Profile("seed", 1, False, 2, 1, 0.0, 0.0, 0.5, 0.0, 0.0, False, False)] * 2
    + [Profile("seed", 1, False, 2, 3, 0.5, 0.2, 0.5, 0.1, 0.0, True, False)],
    552,
)
@given(st.lists(PROFILES, min_size=1, max_size=3), SEEDS)
def test_every_chain_is_found(profiles: list[Profile], seed: int) -> None:
    sessions = [Session(profile, 12, seed + index) for index, profile in enumerate(profiles)]
    capture = Capture([(session.profile, session.records) for session in sessions])
    settled = track(capture)
    assert strays_of(settled) == []
    assert sorted(call.number for call in calls_of(settled)) == list(range(1, len(calls_of(settled)) + 1))
    end = max((seen.time for seen in capture.observations), default=0)
    for session, records, calls in zip(
        sessions, capture.records, calls_by_client(capture, settled), strict=True
    ):
        for call, line in zip(calls, told(records), strict=True):
            # Where others go on for so long, the capture did not end before a reply could come.
            over = end - max(event.observation.time for event in call.frames) >= LATE_WITHIN_NS
            if call.retries and not call.notices:
                over = over or end - call.last_attempt.time >= SHORTEST_SILENCE_NS
            later = line.replace("capture_ended, capture ended", "unanswered, unanswered")
            later = later.replace("capture_ended", "unanswered")
            allowed = [line, later] if over else [line]
            if " answered, " in line and records[call.request.number].call not in session.accepted:
                allowed.append(rejected(line))
            answered = min((n for n, record in records.items() if record.kind != "request"), default=end)
            if call.frames[-1].observation.number < answered:  # as if only requests had been captured
                allowed.append(re.sub(" (unanswered|capture_ended), .*", " not_captured, not captured", line))
            assert summary(call) in allowed


@given(PROFILES, SEEDS)
def test_what_the_client_accepted_is_the_reply(profile: Profile, seed: int) -> None:
    session = Session(profile, 12, seed)
    capture = Capture([(profile, session.records)])
    for number, call in enumerate(calls_of(track(capture))):
        if number in session.accepted and profile.convention != "same":
            assert call.reply is not None
            assert capture.records[0][call.reply.number].attempt == session.accepted[number]


@given(PROFILES, SEEDS)
def test_the_convention_is_found(profile: Profile, seed: int) -> None:
    session = Session(profile, 12, seed)
    calls = calls_of(track(Capture([(profile, session.records)])))
    named = {call.convention for call in calls}
    if profile.is_tcp:
        expected = ReservedConvention.TCP1 if profile.convention == "tcp1" else ReservedConvention.TCP0
        assert calls[-1].convention is expected
    elif profile.convention == "own":
        assert named == {ReservedConvention.OWN}
    else:
        assert named <= {ReservedConvention.UNKNOWN, ReservedConvention(profile.convention)}
        if any(len(call.attempts) > 2 for call in calls):
            assert calls[-1].convention is ReservedConvention(profile.convention)


# Here the reply to a call came after that to the next one, which the client had asked soon after a notice.
@example(Profile(timeout=2, tries=3, loss=0.0, delay=39.0, slow=0.1, restart=0.1), 344356, 0.34375)
# Here only the whole capture has enough requests to prove that it lacks the replies.
@example(Profile(timeout=2, tries=1, loss=0.5, copies=0.0, delay=0.5, slow=0.0, restart=0.0), 272, 0.5)
# Here the reply is late, and a notice of an earlier attempt comes after both the reply and the cut.
@example(Profile("seed", 1, False, 5, 7, 0.1, 0.0, 39.0, slow=0.1, forgetful=True), 261492241, 0.828125)
@given(PROFILES, SEEDS, st.floats(0, 1))
def test_a_capture_that_is_cut_short_gives_the_same_calls_as_far_as_it_goes(
    profile: Profile, seed: int, part: float
) -> None:
    session = Session(profile, 12, seed)
    capture = Capture([(profile, session.records)])
    whole = track(capture)
    by_number = {call.number: call for call in calls_of(whole)}
    tracker = Tracker()
    stop = round(part * len(capture.observations))
    settled = [item for seen in capture.observations[:stop] for item in tracker.observe(seen)]
    assert [summary(call) for call in calls_of(settled)] == [
        summary(call) for call in calls_of(whole[: len(settled)])
    ]
    no_replies = all(seen.flow.direction is Direction.REQUEST for seen in capture.observations)
    for call in calls_of(tracker.close()):
        complete = by_number[call.number]
        assert set(call.frames) <= set(complete.frames)
        assert call.attempts == complete.attempts[: len(call.attempts)]
        proven_later = ["unanswered"] if no_replies and complete.outcome == "not_captured" else []
        assert call.outcome in (complete.outcome, "capture_ended", "not_captured", *proven_later)


# A copy of the first attempt of a Service_Start comes behind other calls.
@example(Profile("seed", 1, False, 2, 2, 0.1, 0.2, 39.0), 7954663)
@settings(max_examples=50)
@given(
    st.builds(
        Profile,
        convention=st.sampled_from(["seed", "own"]),
        first_serial=st.sampled_from([1, 65533]),
        timeout=st.sampled_from([2, 5, 20]),
        tries=st.integers(1, 7),
        loss=st.sampled_from([0.1, 0.5]),
        copies=st.sampled_from([0.0, 0.2]),
        delay=st.sampled_from([4.0, 39.0]),
        echo=st.booleans(),
    ),
    SEEDS,
)
def test_between_the_ends_nothing_is_lost_and_nothing_mixed_up(profile: Profile, seed: int) -> None:
    session = Session(profile, 12, seed)
    capture = Capture([(profile, session.crossing)])
    settled = track(capture)
    records = capture.records[0]
    found = [{event.observation.number for event in call.frames} for call in calls_of(settled)]
    assert strays_of(settled) == []
    calls = {record.call for record in records.values()}
    known = [{number for number, record in records.items() if record.call == call} for call in calls]
    assert sorted(map(sorted, found)) == sorted(map(sorted, known))


STEPS = st.lists(
    st.tuples(
        st.integers(0, 1),  # which client
        st.booleans(),  # a request?
        st.sampled_from([0, 1, 2, 3, 65535]),
        st.sampled_from([0, 1, 2, 3, 65535]),
        st.sampled_from([0, 1, 7, 64, 0x900, 0x809100AA]),
        st.sampled_from([-(10**9), 0, 10**4, 10**6, 3 * 10**6, 2 * 10**8, 10**10, 2 * 10**11]),
    ),
    max_size=40,
)


@given(STEPS, st.sampled_from(Transport), st.booleans())
def test_any_frames_at_any_time_are_each_in_one_place(
    steps: list[tuple[int, bool, int, int, int, int]], transport: Transport, expires: bool
) -> None:
    script = Script()
    clients = [script.client(1), script.client(2, transport)]
    tracker, settled, ms = Tracker(), list[PairingResult](), 0.0
    for index, is_request, serial, reserved, code, gap in steps:
        ms += gap / MS
        client = clients[index]
        if is_request:
            settled += tracker.observe(client.ask(ms, serial, reserved, (code, (i4(serial % 3),))))
        else:
            settled += tracker.observe(client.reply(ms, serial, reserved, code, i4(serial)))
        if expires:
            settled += tracker.expire(script.seen[-1].time)
    settled += tracker.close()
    assert tracker.open_calls == []
    calls = calls_of(settled)
    frames = [event.observation.number for call in calls for event in call.frames]
    frames += [stray.observation.number for stray in strays_of(settled)]
    assert sorted(frames) == [seen.number for seen in script.seen]
    assert sorted(call.number for call in calls) == list(range(1, len(calls) + 1))
    for client in clients:
        numbers = [call.number for call in calls if call.conversation is client.conversation]
        assert numbers == sorted(numbers)
    for call in calls:
        assert (call.reply is not None) == (call.outcome in ("answered", "refused"))
        assert (call.latency is None) == (call.rtt is None) == (call.reply is None)
        assert call.verdict in CallVerdict
