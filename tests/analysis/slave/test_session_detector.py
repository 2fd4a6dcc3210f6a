"""Stays in slave mode: who entered, how it ended, what belongs to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bcapscope.analysis.slave.session_builder import BATCH_SIZE
from bcapscope.analysis.slave.session_detector import MAX_SESSIONS, SlaveSessionDetector
from bcapscope.analysis.slave.slave_session import ExitReason, SlaveSession
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.slave_mode.modes import Generation, ModeKind, PoseType
from bcapscope.traffic.call import Call, CallState
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.observation import Transport
from bcapscope.traffic.pipeline import PipelineSubscriber
from bcapscope.traffic.tracker import Tracker
from tests.analysis.driving import (
    BUFFER_FULL,
    ENTER,
    NOT_ALLOWED,
    NOT_IN_SLAVE_MODE,
    OFF,
    OVERFLOW,
    UNDERFLOW,
    WINDOW,
    Plan,
    Step,
    i4,
    joints,
    play,
    played_calls,
    singles,
    steps,
    watched,
)
from tests.traffic.playbook import (
    CONNECT,
    DISCONNECT,
    ROBOT_RELEASE,
    SERVICE_START,
    SERVICE_STOP,
    START,
    calls_of,
    run_pipeline,
    text,
)

MS = 1_000_000
PACE = [8.0 * n for n in range(1, 21)]


def only(plan: Plan) -> SlaveSession:
    (stay,) = plan.stays()
    return stay


def test_a_whole_stay() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.execute(-8, "slvSendFormat", i4(0x20))
    driver.execute(-6, "slvRecvFormat", Variant.array(VT.I4, (0x12, 1)))
    driver.change(0, ENTER)
    driver.moves(PACE)
    driver.change(170, OFF)
    stay = only(plan)
    assert stay.number == 1
    assert stay.robot == 1
    assert stay.entry_call is not None
    assert (stay.entry_call.request_frame, stay.entry_call.reply_frame, stay.entry_call.command) == (
        5,
        6,
        "slvChangeMode",
    )
    assert str(stay.entry_call.client) == "10.0.0.2:50001"
    assert stay.entered_at == START + MS // 2
    assert (stay.mode.value, stay.mode.known_by, stay.mode.pose_type) == (ENTER, "slvChangeMode", PoseType.J)
    assert stay.mode.meaning is not None
    assert (stay.mode.meaning.kind, stay.mode.guessed) == (ModeKind.MODE_2, False)
    assert stay.send_format == (0x20, False, 1)
    assert stay.receive_format == (0x12, True, 3)
    assert stay.first_set_point == (7, START + 8 * MS)
    assert stay.last_set_point == (45, START + 160 * MS)
    assert stay.exit.reason is ExitReason.LEFT
    assert (stay.exit.frames, stay.exit.time) == ((47, 48), START + 170 * MS + MS // 2)
    assert (stay.counts.sent, stay.counts.accepted, stay.counts.after_end) == (20, 20, 0)
    assert stay.duration_ms == pytest.approx(170)
    assert [call.command for call in stay.other_calls] == [
        "slvSendFormat",
        "slvRecvFormat",
        "slvChangeMode",
        "slvChangeMode",
    ]


def test_a_stay_that_began_before_the_capture() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.moves(PACE)
    driver.change(170, OFF)
    stay = only(plan)
    assert stay.began_before_capture
    assert stay.entered_at == START + 8 * MS
    assert (stay.mode.value, stay.mode.known_by, stay.mode.meaning) == (None, "", None)
    assert stay.mode.pose_type is PoseType.J


def test_slv_get_mode_tells_the_mode_of_a_stay_that_began_before() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.moves(PACE[:5])
    driver.execute(44, "slvGetMode", result=i4(ENTER))
    driver.moves(PACE[5:])
    stay = only(plan)
    assert (stay.mode.value, stay.mode.known_by) == (ENTER, "slvGetMode")


def test_an_entry_whose_reply_was_lost() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER, takes=None)
    driver.moves(PACE)
    stay = only(plan)
    assert stay.entry_call is not None
    assert (stay.entry_call.request_frame, stay.entry_call.reply_frame, stay.mode.value) == (1, None, ENTER)


def test_a_refused_entry_is_none() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER, code=0x83501024)
    for ms in PACE:
        driver.move(ms, code=NOT_IN_SLAVE_MODE)
    assert plan.stays() == []


def test_an_error_ends_it_and_what_follows_is_a_consequence() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(PACE)
    driver.move(250, code=UNDERFLOW)
    driver.move(258, code=NOT_IN_SLAVE_MODE)
    driver.move(266, code=0x81501025)
    driver.execute(300, "Motor", i4(1), code=0x81501025)
    stay = only(plan)
    assert (stay.exit.reason, stay.exit.hresult, stay.exit.frames) == (ExitReason.ERROR, UNDERFLOW, (43, 44))
    assert (stay.counts.refused, stay.counts.after_end) == ({UNDERFLOW: 1}, 2)
    assert stay.refused_set_points[0].request_frame == 43
    assert stay.buffer.reported_underflows == (44,)
    assert stay.buffer.underflow_list[0].late_frame == 43
    assert stay.timing.gap_list[0].request_frame == 43
    assert stay.timing.gap_list[0].cycle_ms == pytest.approx(90)


def test_an_error_that_does_not_end_it() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(PACE[:5])
    driver.move(44, code=0x80070057)
    driver.moves(PACE[5:])
    driver.change(170, OFF)
    stay = only(plan)
    assert (stay.exit.reason, stay.counts.refused) == (ExitReason.LEFT, {0x80070057: 1})
    assert (stay.counts.sent, stay.counts.after_end) == (21, 0)


def test_a_full_buffer_is_no_end() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, 0x002)
    driver.moves(PACE[:3])
    driver.move(25, code=BUFFER_FULL)
    driver.move(26, code=OVERFLOW)
    driver.move(32, joints(2.6))
    driver.moves(PACE[4:])
    stay = only(plan)
    assert stay.exit.reason is ExitReason.CAPTURE_ENDED
    assert (stay.counts.buffer_full, stay.counts.refused) == (1, {OVERFLOW: 1})
    assert stay.counts.sent == stay.counts.accepted + 1
    assert stay.motion is not None
    assert stay.motion.repeated == 0, "the point that is sent again was not taken the first time"


def test_found_off_by_another_client() -> None:
    plan = Plan()
    driver, other = plan.driver(), plan.driver(50002)
    driver.change(0, ENTER)
    driver.moves(PACE)
    other.change(163, OFF)
    driver.move(168, code=NOT_IN_SLAVE_MODE)
    stay = only(plan)
    assert stay.exit.reason is ExitReason.OTHER_CLIENT
    assert stay.exit.by is not None
    assert str(stay.exit.by.client) == "10.0.0.2:50002"
    assert stay.exit.frames == (43, 44, 45, 46)


def test_found_off_after_a_call_that_was_not_allowed() -> None:
    plan = Plan()
    driver, other = plan.driver(), plan.driver(50002, Transport.TCP)
    driver.change(0, ENTER)
    driver.moves(PACE)
    other.execute(162, "HandMoveA", code=NOT_ALLOWED)
    driver.move(168, code=NOT_IN_SLAVE_MODE)
    driver.move(9000, code=NOT_IN_SLAVE_MODE)
    stay = only(plan)
    assert (stay.exit.reason, stay.exit.hresult) == (ExitReason.OTHER_CALL, NOT_ALLOWED)
    assert stay.exit.by is not None
    assert stay.exit.by.command == "HandMoveA"


def test_found_off_after_an_error_of_four_digits_as_an_rc7_gives_it() -> None:
    plan = Plan()
    driver, other = plan.driver(), plan.driver(50002, Transport.TCP)
    driver.change(0, 0x002)
    driver.moves(PACE)
    other.execute(162, "Motor", code=0x2006)
    driver.move(168, code=NOT_IN_SLAVE_MODE)
    stay = only(plan)
    assert (stay.exit.reason, stay.exit.hresult) == (ExitReason.OTHER_CALL, 0x2006)


def test_found_off_and_nobody_did_it() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(PACE)
    driver.move(168, code=NOT_IN_SLAVE_MODE)
    stay = only(plan)
    assert (stay.exit.reason, stay.exit.frames) == (ExitReason.FOUND_OFF, (43, 44))
    assert (stay.counts.sent, stay.counts.after_end) == (20, 1)


def test_off_at_once() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.move(8, code=NOT_IN_SLAVE_MODE)
    stay = only(plan)
    assert (stay.exit.reason, stay.first_set_point, stay.counts.after_end) == (ExitReason.FOUND_OFF, None, 1)


@pytest.mark.parametrize(
    ("function", "arguments"),
    [
        (SERVICE_STOP, ()),
        (DISCONNECT, (i4(7),)),
        (ROBOT_RELEASE, (i4(1),)),
        (SERVICE_START, (text(""),)),
    ],
)
def test_a_client_that_lets_go(function: int, arguments: tuple[Variant, ...]) -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(PACE)
    driver.call(170, function, *arguments)
    assert only(plan).exit.reason is ExitReason.DISCONNECTED


def test_another_robot_that_is_let_go_ends_nothing() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(PACE[:10])
    driver.call(84, ROBOT_RELEASE, i4(2))
    driver.moves(PACE[10:])
    assert only(plan).counts.sent == 20


def test_the_capture_ends_or_the_client_falls_silent() -> None:
    plan = Plan()
    driver, other = plan.driver(), plan.driver(50002)
    driver.change(0, ENTER)
    driver.moves(PACE)
    assert only(plan).exit.reason is ExitReason.CAPTURE_ENDED
    other.execute(5000, "CurJnt")
    assert only(plan).exit.reason is ExitReason.SILENT


def test_one_mode_after_the_other() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(PACE[:10])
    driver.change(84, 0x101)
    driver.execute(88, "SLVMOVE", Variant.array(VT.R8, (1.0,) * 7))
    driver.change(100, OFF)
    first, second = plan.stays()
    assert (first.exit.reason, first.counts.sent) == (ExitReason.CHANGED, 10)
    assert (second.number, second.mode.pose_type, second.counts.sent) == (2, PoseType.P, 1)
    assert second.exit.reason is ExitReason.LEFT


def test_set_points_of_another_client_than_the_one_that_entered() -> None:
    plan = Plan()
    watch, arm = plan.driver(50002, Transport.TCP), plan.driver()
    watch.change(0, ENTER)
    arm.moves(PACE)
    stay = only(plan)
    assert (stay.conversation.client.port, stay.mode.value) == (50001, ENTER)
    assert stay.entry_call is not None
    assert stay.entry_call.client.port == 50002


def test_two_robots_at_a_time() -> None:
    plan = Plan()
    left, right = plan.driver(), plan.driver(50002, handle=3)
    left.change(0, ENTER)
    right.change(1, 0x102)
    for ms in PACE:
        left.move(ms)
        right.move(ms + 3)
    right.change(180, OFF)
    left.change(181, OFF)
    stays = sorted(plan.stays(), key=lambda stay: stay.number)
    assert [(stay.robot, stay.counts.sent, stay.mode.value) for stay in stays] == [
        (1, 20, ENTER),
        (3, 20, 0x102),
    ]
    assert all(stay.exit.reason is ExitReason.LEFT for stay in stays)


def test_retries_and_where_they_are_forbidden() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, 0x102)
    for n, ms in enumerate(PACE):
        driver.move(ms, retries=(2.0, 4.0)[: n % 3])
    stay = only(plan)
    assert stay.counts.by_retries == {0: 7, 1: 7, 2: 6}
    assert (stay.counts.retries, stay.counts.retries_forbidden) == (19, 19)
    assert stay.forbidden_retry_frames[0] == 6
    tcp = Plan()
    other = tcp.driver(transport=Transport.TCP)
    other.change(0, 0x102)
    other.moves(PACE)
    assert only(tcp).counts.retries_forbidden == 0


def test_unanswered_set_points_belong_to_the_stay() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    for n, ms in enumerate(PACE):
        driver.move(ms, takes=None if n % 4 == 1 else 0.5)
    stay = only(plan)
    assert (stay.counts.sent, stay.counts.unanswered, stay.counts.accepted) == (20, 5, 15)


def test_a_set_point_that_is_let_go_is_not_unanswered() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(PACE)
    driver.move(168, takes=None)
    driver.move(176, takes=None)
    *calls, let_go, _ = (call for call in plan.track() if isinstance(call, Call))
    let_go.state = CallState.EVICTED
    watcher = SlaveSessionDetector()
    for call in (*calls, let_go):
        assert not watcher.add_call(call)
    (stay,) = watcher.remaining_sessions()
    counts = stay.counts
    assert (counts.sent, counts.unanswered, counts.open, counts.not_followed) == (21, 0, 0, 1)
    assert stay.timing.deadlines[0].late == 0


def test_set_points_in_a_capture_of_requests_only_are_not_unanswered() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(PACE)
    driver.change(200, OFF)
    plan.track()
    requests = [seen for seen in plan.script.seen if seen.flow.direction == "request"]
    tracker, watcher = Tracker(), SlaveSessionDetector()
    calls = calls_of([item for seen in requests for item in tracker.observe(seen)] + list(tracker.close()))
    found = [session for call in calls for session in watcher.add_call(call)]
    (stay,) = [*found, *watcher.remaining_sessions()]
    counts = stay.counts
    assert (counts.sent, counts.unanswered, counts.open, counts.not_captured) == (20, 0, 0, 20)
    assert stay.exit.reason is ExitReason.LEFT


def test_a_set_point_that_waits_when_the_capture_ends_is_not_unanswered() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(PACE)
    driver.move(168, takes=None)
    stay = only(plan)
    assert (stay.counts.sent, stay.counts.unanswered, stay.counts.open, stay.counts.accepted) == (
        21,
        0,
        1,
        20,
    )


@pytest.mark.parametrize(
    ("prepare", "pose", "generation", "kind", "why"),
    [
        (lambda driver: None, singles(1.0), Generation.RC7, ModeKind.SYNC, "VT_R4"),
        (lambda driver: None, joints(1.0), Generation.RC8, ModeKind.MODE_0, "VT_R8"),
        (
            lambda driver: driver.call(-9, CONNECT, *map(text, ("", "CaoProv.DENSO.VRC9", "localhost", ""))),
            None,
            Generation.RC8,
            ModeKind.MODE_0,
            "CaoProv.DENSO.VRC",
        ),
        (
            lambda driver: driver.execute(-9, "slvRecvFormat", i4(2)),
            None,
            Generation.RC8,
            ModeKind.MODE_0,
            "slvRecvFormat",
        ),
    ],
)
def test_the_same_mode_means_different_things(
    prepare: Callable[[object], None],
    pose: Variant | None,
    generation: Generation,
    kind: ModeKind,
    why: str,
) -> None:
    plan = Plan()
    driver = plan.driver()
    prepare(driver)
    driver.change(0, 0x002)
    if pose is not None:
        driver.move(8, pose)
    stay = only(plan)
    assert stay.mode.generation is generation
    assert why in str(stay.mode.generation_known_by)
    assert stay.mode.meaning is not None
    assert stay.mode.meaning.kind is kind


def test_no_argument_after_slv_change_mode_is_an_rc7() -> None:
    plan = Plan()
    plan.driver().execute(0, "slvChangeMode", Variant(VT.I2, 0x101), result=None)
    stay = only(plan)
    assert (stay.mode.generation, stay.first_set_point) == (Generation.RC7, None)


def test_more_set_points_than_are_looked_at_together() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    count = BATCH_SIZE * 2 + 5
    driver.moves(8.0 * n for n in range(1, count + 1))
    driver.change(8.0 * (count + 1), OFF)
    stay = only(plan)
    assert (stay.counts.sent, stay.counts.accepted) == (count, count)
    assert stay.timing.cycle is not None
    assert stay.timing.cycle.count == count - 1
    assert stay.timing.cycle.most == pytest.approx(8.0)
    assert stay.motion is not None
    assert (stay.motion.read, stay.motion.returned) == (count, count)


def test_stays_are_given_out_while_traffic_goes_on() -> None:
    plan = Plan()
    driver = plan.driver()
    for n in range(5):
        driver.change(n * 10_000, ENTER)
        driver.moves(n * 10_000 + ms for ms in PACE)
        driver.change(n * 10_000 + 200, OFF)
    settled = plan.track()
    assert len(watched(settled)) == 5
    assert len(watched(settled[:-22])) == 4


def test_stays_without_end_are_bounded() -> None:
    plan = Plan()
    for n in range(MAX_SESSIONS + 9):
        plan.driver(1000 + n, handle=n).moves([8.0 + n / 100, 16.0 + n / 100])
    stays = plan.stays()
    assert len(stays) >= MAX_SESSIONS + 9, "one that was given up and goes on is another stay"
    assert sum(stay.counts.sent for stay in stays) == 2 * (MAX_SESSIONS + 9)


def test_the_session_that_was_silent_longest_ends_when_another_begins() -> None:
    plan = Plan()
    for n in range(MAX_SESSIONS + 1):
        plan.driver(1000 + n, handle=n).move(8.0 + n / 100)
    newest = plan.driver(2000, handle=2000)
    newest.moves([50.0, 58.0])
    stays = plan.stays()
    assert [stay.counts.sent for stay in stays] == [1] * (MAX_SESSIONS + 1) + [2]
    ended = [stay.conversation.client.port for stay in stays if stay.exit.reason is ExitReason.SILENT]
    assert ended == [1000, 1001]


def test_the_first_point_is_compared_with_where_the_robot_stands() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.execute(-20, "CurJnt", result=joints(0.5, 30.0))
    driver.change(0, ENTER)
    driver.move(8, joints(0.5, 32.0), result=Variant(VT.EMPTY, None))
    motion = only(plan).motion
    assert motion is not None
    assert motion.first_distance[:2] == (0.0, 2.0)
    assert str(motion.first_distance_known_by) == "an earlier CurJnt"
    assert motion.first_distance_frames == (1, 2, 5)


def test_the_pose_in_the_first_reply_counts_more() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.execute(-20, "CurJnt", result=joints(9.0))
    driver.change(0, ENTER)
    driver.move(8, joints(1.0), result=joints(0.25))
    motion = only(plan).motion
    assert motion is not None
    assert motion.first_distance[0] == 0.75


def test_time_stamps_come_by_the_receive_format() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.execute(-6, "slvRecvFormat", Variant.array(VT.I4, (0x12, 1)))
    driver.change(0, ENTER)
    for ms in PACE:
        answer = Variant.array(VT.VARIANT, (i4(int(ms * 1000)), joints(ms / 10)))
        driver.move(ms, result=answer)
    stay = only(plan)
    assert stay.clock is not None
    assert (stay.clock.stamps, stay.clock.microseconds, stay.clock.missing) == (20, True, 0)
    assert stay.motion is not None
    assert stay.motion.returned == 20


def test_slices_of_time() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(8.0 * n for n in range(1, 501))
    (stay,) = plan.stays(window=1_000 * MS)
    assert [each.sent for each in stay.slices] == [125, 125, 125, 125]
    assert [each.begin for each in stay.slices] == [START + 8 * MS + n * 1_000 * MS for n in range(4)]
    assert sum(each.cycle.count for each in stay.slices if each.cycle) == 499


@settings(deadline=None, max_examples=150)
@given(steps, st.integers(0, 2))
def test_no_sequence_of_calls_breaks_it(played: list[Step], release: int) -> None:
    stays = play(played, release)
    sent = sum(stay.counts.sent + stay.counts.after_end for stay in stays)
    assert sent <= sum(step.command == "slvMove" for step in played)
    for stay in stays:
        counts = stay.counts
        without_reply = counts.unanswered + counts.open
        assert counts.sent == counts.accepted + without_reply + sum(counts.refused.values())
        assert sum(counts.by_retries.values()) == counts.sent
        assert sum(each.sent for each in stay.slices) == counts.sent
        assert sum(sample.points for sample in stay.samples) == counts.sent
        # A client that does not wait may leave before it hears that it has entered.
        overlapping = stay.exit.by is not None and stay.exit.by.time <= (stay.entered_at or 0)
        assert stay.first_set_point is None or overlapping or stay.exit.time >= (stay.entered_at or 0)
        assert (stay.motion is None) == (stay.first_set_point is None)
    assert sorted(stay.number for stay in stays) == list(range(1, len(stays) + 1))


def test_a_call_that_failed_long_before_the_last_set_point_was_taken_did_not_end_it() -> None:
    plan = Plan()
    driver, other = plan.driver(), plan.driver(50002)
    driver.change(0, ENTER)
    driver.moves(8.0 * n for n in range(1, 61))
    other.execute(100, "HandMoveA", code=NOT_ALLOWED)
    driver.move(488, code=NOT_IN_SLAVE_MODE)
    assert only(plan).exit.reason is ExitReason.FOUND_OFF


def test_stays_of_a_client_that_is_gone_are_given_out_at_once() -> None:
    plan = Plan()
    silent, other = plan.driver(), plan.driver(50002)
    silent.change(0, ENTER)
    silent.moves([8.0, 16.0])
    other.change(20, ENTER)
    other.moves([28.0, 36.0])
    watcher = SlaveSessionDetector()
    calls = [call for call in plan.track() if isinstance(call, Call)]
    assert [stay for call in calls for stay in watcher.add_call(call)] == []
    (stay,) = watcher.close_conversation(calls[0].conversation)
    assert (stay.conversation, stay.exit.reason) == (calls[0].conversation, ExitReason.SILENT)
    assert watcher.close_conversation(calls[0].conversation) == ()
    (rest,) = watcher.remaining_sessions()
    assert rest.conversation is not stay.conversation


def asked_at(calls: list[Call], cuts: set[int]) -> list[str]:
    """Return all sessions as text, NaN included, of a detector that is asked after some of the calls."""
    detector, found = SlaveSessionDetector(WINDOW), list[SlaveSession]()
    for number, call in enumerate(calls, 1):
        found += detector.add_call(call)
        if number in cuts:
            remaining = detector.remaining_sessions()
            assert repr([*found, *remaining]) == repr(watched(calls[:number], WINDOW))
            assert repr(remaining) == repr(detector.remaining_sessions())
    return [repr(session) for session in (*found, *detector.remaining_sessions())]


@settings(deadline=None, max_examples=50)
@given(steps, st.integers(0, 2))
def test_asking_for_the_remaining_sessions_changes_nothing(played: list[Step], release: int) -> None:
    calls = [call for call in played_calls(played, release) if isinstance(call, Call)]
    assert asked_at(calls, set(range(len(calls)))) == asked_at(calls, set())


def test_asking_about_a_long_session_changes_none_of_its_figures() -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    for n in range(1, 3 * BATCH_SIZE):
        driver.move(8.0 * n + n % 7 / 10, takes=0.3 + n % 11 / 10)
    calls = [call for call in plan.track() if isinstance(call, Call)]
    cuts = {2, 3, 1000, BATCH_SIZE, BATCH_SIZE + 2, 2 * BATCH_SIZE + 1000, 2 * BATCH_SIZE + 1001}
    assert asked_at(calls, cuts) == asked_at(calls, set())


@given(steps)
def test_runs_of_set_points_give_the_same_sessions_as_single_ones(played: list[Step]) -> None:
    class Singles(PipelineSubscriber):
        def __init__(self) -> None:
            self.detector = SlaveSessionDetector()
            self.sessions: list[SlaveSession] = []

        def on_call(self, call: Call, target: TrackedObject | None) -> None:
            self.sessions += self.detector.add_call(call)

    class Runs(Singles):
        def on_set_points(self, calls: Sequence[Call]) -> None:
            self.sessions += self.detector.add_set_points(calls)

    plan = Plan()
    drivers = [plan.driver(50001), plan.driver(50002, handle=2)]
    now = 0.0
    for step in played:
        for _ in range(4):
            now += step.after
            drivers[step.who % 2].execute(
                now, step.command, step.parameter, code=step.code, result=step.result, takes=step.takes
            )
    plan.track()
    each_call, in_runs = Singles(), Runs()
    run_pipeline(plan.script.seen, each_call, in_runs)
    found = [[*each.sessions, *each.detector.remaining_sessions()] for each in (each_call, in_runs)]
    assert sorted(map(repr, found[0])) == sorted(map(repr, found[1]))
