"""A diagnosis as a whole: stories with a first cause, damage, bounds."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.finding import Severity, TrafficTotals
from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.protocol.codec.frame import Frame, Malformed, encode_frame, parse_single_frame
from bcapscope.protocol.codec.variant import EMPTY
from bcapscope.traffic import tracker
from bcapscope.traffic.observation import (
    SERVER_PARTICIPANT,
    SERVER_PORT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    ServerEvidence,
    Transport,
)
from bcapscope.traffic.pipeline import Pipeline
from tests.analysis.driving import ENTER, Plan
from tests.analysis.plays import SCENES
from tests.analysis.scenes import HOME, ROBOT, Diagnosed, Story, diagnose, diagnose_bytes, good, stage
from tests.samples import trouble
from tests.samples.calls import START, i4, r8s, reply, request, text
from tests.samples.findings import sentence_of
from tests.samples.problems import problem_of
from tests.shared_folder import SHARED

RECORDINGS = SHARED / "captures"


def chain(found: Diagnosed) -> list[tuple[str, int | None]]:
    return [(finding.rule, finding.consequence_of) for finding in found.findings]


def test_nothing_seen() -> None:
    diagnosis = Diagnosis()
    assert diagnosis.findings() == ()
    assert diagnosis.totals() == TrafficTotals(0, 0, 0, 0)


def test_a_clean_capture_says_how_much_was_seen() -> None:
    found = stage(good)
    assert found == Diagnosed((), TrafficTotals(142, 71, 1, 546_000_000, began=START))


def test_calls_that_are_let_go_accuse_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nine set points a quarter of a millisecond apart are answered at last, when half are not looked for."""
    monkeypatch.setattr(tracker, "MAX_OPEN", 4)

    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.ready()
        client.enter(40)
        asked = [
            client.ask(50 + number / 4, "Robot_Execute", ROBOT, text("slvMove"), r8s(*HOME))
            for number in range(9)
        ]
        for serial in asked:
            client.answer(53, serial, r8s(*HOME))
        client.leave(4000)

    found = stage(play)
    assert found.findings == ()
    assert found.seen.not_followed == 5


def test_a_controller_that_never_answers_is_told_though_calls_are_let_go(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(tracker, "MAX_OPEN", 4)

    def play(story: Story, answered: int = 0) -> None:
        client = story.client()
        for number in range(9):
            client.ask(number, "Service_Start", text(""))
        if answered:
            client.answer(10, answered)

    assert [finding.rule for finding in stage(play).findings] == ["controller-silent"]
    assert stage(lambda story: play(story, 1)).findings == ()


def test_a_late_reply_is_the_first_cause_of_a_lost_slave_mode() -> None:
    def play(story: Story) -> None:
        client = story.client()
        client.drive(10)
        asked = client.ask(130, "Robot_Execute", ROBOT, text("slvMove"), r8s(0.5, *HOME[1:]), serial=4711)
        client.ask(146, "Robot_Execute", ROBOT, text("slvMove"), r8s(0.55, *HOME[1:]), serial=4712)
        client.answer(149, asked, r8s(0.5, *HOME[1:]))
        client.answer(157, 4712, EMPTY, code=0x84201482)
        for number in range(5):
            client.point(162 + 8 * number, 0.6, 0x83500121)

    found = stage(play)
    assert found.findings[0].rule == "client-gave-up"
    assert sentence_of(found.findings[0]).startswith(
        "The reply to slvMove 4711 came 19 ms after the request. Your client had given up after 16 ms. "
    )
    assert "8.0 ms later" in sentence_of(found.findings[0])
    assert sentence_of(found.findings[0]).endswith("Everything after that is a consequence.")
    assert chain(found)[:3] == [("client-gave-up", None), ("underflow", 1), ("slvmove-outside-slave-mode", 2)]


def test_a_pause_is_the_first_cause() -> None:
    found = diagnose_bytes(trouble.slave_mode_lost())
    assert chain(found) == [
        ("set-point-gap", None),
        ("underflow", 1),
        ("slvmove-outside-slave-mode", 2),
        ("went-on-after-error", 2),
        ("error-not-cleared", 2),
    ]


def test_another_client_is_the_first_cause() -> None:
    play = next(scene.fires for scene in SCENES if scene.rule == "refused-in-slave-mode")
    found = stage(play)
    assert chain(found)[:2] == [("refused-in-slave-mode", None), ("slvmove-outside-slave-mode", 1)]


@pytest.mark.parametrize(
    "name", ["slvMove\x1b[2J", "one\ntwo", "[/foo]", "\ud800", "\u202egpj", "x" * 5000, "{at:time}", "%s%n"]
)
def test_hostile_names_are_carried_as_they_are(name: str) -> None:
    def play(story: Story) -> None:
        client = story.client(tcp=True)
        client.open()
        client.execute(50, name, i4(1), code=0x80010005)
        client.call(60, "Controller_GetVariable", i4(1), text(name), text(""), code=0x80000204)

    findings = stage(play).findings
    assert [finding.rule for finding in findings] == ["unknown-command", "controller-error"]
    assert name[:20] in sentence_of(findings[0])
    assert all(len(sentence_of(finding)) < 600 for finding in findings)


@pytest.mark.parametrize("scene", SCENES[::5], ids=lambda scene: str(scene.rule))
def test_any_beginning_of_a_capture_can_be_diagnosed(scene: object) -> None:
    story = Story()
    scene.fires(story)  # type: ignore[attr-defined]
    whole = story.capture()
    for stop in range(24, len(whole), max(len(whole) // 12, 1)):
        try:
            diagnose_bytes(whole[:stop])
        except Exception as error:
            assert type(error).__name__ == "CaptureError"  # noqa: PT017


_CODES = st.sampled_from(
    (0, 0x900, 0x0F200501, 0x84201482, 0x83500121, 0x83501032, 0x84204043, 0x80070057, 0x809100AA)
)
_CONVERSATIONS = tuple(
    Conversation(Endpoint("10.0.0.2", 50001 + number), Endpoint("10.0.0.1", 5007), transport, SERVER_PORT)
    for number, transport in enumerate((Transport.UDP, Transport.TCP, Transport.UDP))
)
_FLOWS = tuple(Flow(each, direction) for each in _CONVERSATIONS for direction in Direction)
_REQUESTS = (
    request(1, 0, "Service_Start", text("WDT=400")),
    request(1, 0, "Service_Stop"),
    request(1, 0, "Robot_Execute", ROBOT, text("slvMove"), r8s(*HOME)),
    request(1, 0, "Robot_Execute", ROBOT, text("slvChangeMode"), i4(0x202)),
    request(1, 0, "Robot_Execute", ROBOT, text("slvChangeMode"), text("514")),
    request(1, 0, "Controller_GetRobot", i4(1), text("Arm"), text("")),
    request(1, 0, "Robot_Release", ROBOT),
    encode_frame(1, 0, 200, ()),
)


ENTRY = parse_single_frame(encode_frame(0, 0, 64, (i4(2), text("slvChangeMode"), i4(0x202))))
GAP = Malformed(b"", (problem_of(0, "gap", "bytes were not seen"),), 7)


@st.composite
def _item(draw: st.DrawFn) -> tuple[int, int, Frame | Malformed]:
    flow = draw(st.integers(0, len(_FLOWS) - 1))
    pause = draw(st.sampled_from((0, 1_000, 1_000_000, 8_000_000, 30_000_000, 2_000_000_000)))
    if draw(st.integers(0, 30)) == 0:
        return flow, pause, GAP
    if _FLOWS[flow].direction is Direction.REQUEST:
        raw = draw(st.sampled_from(_REQUESTS))
    else:
        raw = reply(1, 0, draw(st.sampled_from((i4(2), EMPTY, r8s(*HOME)))), hresult=draw(_CODES))
    serials = draw(st.integers(0, 6)).to_bytes(2, "little") + draw(st.integers(0, 6)).to_bytes(2, "little")
    raw = raw[:5] + serials + raw[9:]
    cut = draw(st.integers(0, 10 * len(raw)))
    return flow, pause, parse_single_frame(raw[:cut] if 0 < cut < len(raw) else raw)


# The client enters slave mode, sends no set point, and the capture lacks what follows.
@example([(0, 0, ENTRY), *[(0, 2_000_000_000, GAP)] * 4, (1, 2_000_000_000, GAP)])
@given(st.lists(_item(), max_size=60))
def test_any_traffic_can_be_diagnosed(items: list[tuple[int, int, Frame | Malformed]]) -> None:
    time, seen = 1_700_000_000_000_000_000, []
    for number, (flow, pause, item) in enumerate(items, 1):
        time += pause
        seen.append(Observation(number, time, time, _FLOWS[flow], item, number))
    found = diagnose(seen)
    assert found.seen.frames == len(seen)
    for number, finding in enumerate(found.findings, 1):
        assert finding.consequence_of is None or finding.consequence_of < number
        assert 1 <= finding.frames[0] <= finding.frames[-1] <= len(seen)
        assert sentence_of(finding).endswith(".")


def test_memory_is_bounded_by_what_is_open_and_not_by_what_was_seen() -> None:
    """What a diagnosis holds after many calls that were all refused is what it holds after some."""

    def held(calls: int) -> int:
        diagnosis = Diagnosis()
        pipeline = Pipeline(diagnosis)
        ask, answer = _FLOWS[0], _FLOWS[1]
        flows = {flow.direction: flow for flow in (ask, answer)}
        for number in range(1, calls + 1):
            time = number * 8_000_000
            serial = number % 65535 + 1
            frames = (
                (Direction.REQUEST, request(serial, 0, "Robot_Execute", ROBOT, text("slvMove"), r8s(*HOME))),
                (Direction.RESPONSE, reply(serial, 0, hresult=0x83500121)),
            )
            for place, (direction, raw) in enumerate(frames):
                seen = Observation(2 * number + place, time, time, flows[direction], Frame(raw), 0)
                pipeline.add(seen)
        book = diagnosis._collector
        return sum(1 for case in book._groups.values() for _ in case) + len(book._by_call)

    assert held(9000) == held(12000)


@pytest.mark.parametrize(
    ("evidence", "rule"), [(SERVER_PORT, "capture-gap"), (SERVER_PARTICIPANT, "malformed-request")]
)
def test_a_proxy_has_seen_each_stream_from_its_beginning(evidence: ServerEvidence, rule: str) -> None:
    ends = Endpoint("10.0.0.2", 50001), Endpoint("10.0.0.1", 5007)
    flow = Flow(Conversation(*ends, Transport.TCP, evidence), Direction.REQUEST)
    diagnosis = Diagnosis()
    item = Malformed(b"GET / HTTP/1.0\r\n\r\n", (problem_of(0, "outside", "bytes outside of any frame"),))
    diagnosis.on_frame(Observation(1, 0, 0, flow, item, 0))
    assert [finding.rule for finding in diagnosis.findings()] == [rule]


@pytest.mark.parametrize(
    ("count", "said"),
    [
        (1, "at 0.000 s is malformed: no. 0."),
        (2, "at 0.000 s is malformed: no. 0; no. 1."),
        (4, "at 0.000 s is malformed: no. 0; no. 1; no. 2; and 1 more problem."),
    ],
)
def test_the_first_problems_of_a_frame_are_named(count: int, said: str) -> None:
    problems = tuple(problem_of(number, "length", f"no. {number}") for number in range(count))
    diagnosis = Diagnosis()
    diagnosis.on_frame(Observation(1, 0, 0, _FLOWS[0], Malformed(b"\x02", problems), 0))
    (finding,) = diagnosis.findings()
    assert sentence_of(finding).endswith(said)


@pytest.mark.interop
@pytest.mark.parametrize("name", ["tcp.pcapng", "udp_clean.pcap"])
def test_recordings_without_loss_have_neither_errors_nor_warnings(name: str) -> None:
    path = RECORDINGS / name
    if not path.exists():
        pytest.skip(f"{path} is missing")
    with open_capture(path) as capture:
        found = diagnose(list(PacketDecoder().decode(capture)))
    assert found.seen.calls == 2010
    assert [finding.rule for finding in found.findings if finding.severity is not Severity.NOTE] == []


@pytest.mark.interop
def test_a_recording_with_loss_shows_it() -> None:
    path = RECORDINGS / "udp_loss.pcapng"
    if not path.exists():
        pytest.skip(f"{path} is missing")
    with open_capture(path) as capture:
        found = diagnose(list(PacketDecoder().decode(capture)))
    rules = {finding.rule for finding in found.findings}
    assert {"retried", "executed-twice", "slow-retry"} <= rules
    assert "client-stopped" not in rules


@pytest.mark.parametrize(
    ("direction", "rule"), [(Direction.REQUEST, "malformed-request"), (Direction.RESPONSE, "malformed-reply")]
)
def test_a_damaged_frame_among_accepted_set_points_is_found(direction: Direction, rule: str) -> None:
    plan = Plan()
    driver = plan.driver()
    driver.change(0, ENTER)
    driver.moves(8.0 * n + 8 for n in range(20))
    driver.change(200, 0)
    plan.track()
    seen = list(plan.script.seen)
    place = next(n for n, each in enumerate(seen) if n > 20 and each.flow.direction is direction)
    seen[place] = seen[place]._replace(item=Frame(seen[place].item.raw[:-1] + b"\x05"))
    (found,) = diagnose(seen).of(rule)
    assert found.frames == (seen[place].number,)
