"""What a filter leaves of a diagnosis: all that concerns the chosen calls and what that follows from."""

from __future__ import annotations

import io
from collections.abc import Callable

import pytest

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.finding import Finding
from bcapscope.capture.capture_file import CaptureFile
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.traffic.call import Call
from bcapscope.traffic.filter.compiler import compile_filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.filter.getters import CALL_GETTERS
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.tracker import Tracker
from tests.analysis.plays import SCENES
from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import HOME, ROBOT, Play, Story
from tests.samples.calls import r8s, text
from tests.traffic.playbook import run_pipeline


def by(expression: str) -> Callable[[Call], bool]:
    return compile_filter(expression, RecordKind.CALL).bind(CALL_GETTERS)


def observed(play: Play) -> list[Observation]:
    story = Story()
    play(story)
    return list(PacketDecoder(frozenset({5007})).decode(CaptureFile(io.BytesIO(story.capture()))))


def diagnosed(
    seen: list[Observation], chosen: Callable[[Call], bool] | None
) -> tuple[tuple[Finding, ...], Diagnosis]:
    diagnosis = Diagnosis(chosen)
    run_pipeline(seen, diagnosis)
    return diagnosis.findings(), diagnosis


def lost_mode(story: Story) -> None:
    """A reply comes too late, slave mode is lost for it; at the end the client goes without a word."""
    client = story.client()
    client.drive(10)
    asked = client.ask(130, "Robot_Execute", ROBOT, text("slvMove"), r8s(0.5, *HOME[1:]), serial=4711)
    client.ask(146, "Robot_Execute", ROBOT, text("slvMove"), r8s(0.55, *HOME[1:]), serial=4712)
    client.answer(149, asked, r8s(0.5, *HOME[1:]))
    client.answer(157, 4712, code=0x84201482)
    for number in range(5):
        client.point(162 + 8 * number, 0.6, 0x83500121)


def test_what_is_told_keeps_its_cause_though_that_was_not_asked_for() -> None:
    seen = observed(lost_mode)
    everything, _ = diagnosed(seen, None)
    told, _ = diagnosed(seen, by("hresult == 0x83500121"))
    assert [each.rule for each in told[:3]] == ["client-gave-up", "underflow", "slvmove-outside-slave-mode"]
    assert [each.consequence_of for each in told[:3]] == [None, 1, 2]
    assert {each.rule for each in told} <= {each.rule for each in everything}


def test_what_does_not_concern_the_chosen_calls_is_left_out() -> None:
    seen = observed(lost_mode)
    told, diagnosis = diagnosed(seen, by("function == Service_Start"))
    assert told == ()
    assert diagnosis.totals().selected_calls == 1
    assert diagnosis.totals().calls > 1


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.rule)
def test_nothing_is_told_when_nothing_was_asked_for(scene: Scene) -> None:
    told, diagnosis = diagnosed(observed(scene.fires), by("false"))
    assert told == ()
    assert diagnosis.totals().selected_calls == 0


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.rule)
def test_all_calls_chosen_leave_out_only_what_concerns_no_call(scene: Scene) -> None:
    seen = observed(scene.fires)
    everything, _ = diagnosed(seen, None)
    told, _ = diagnosed(seen, by("true"))
    tracker = Tracker()
    settled = [each for one in seen for each in tracker.observe(one)] + list(tracker.close())
    calls = [call for call in settled if isinstance(call, Call)]
    frames = {each.observation.number for call in calls for each in call.frames}
    for finding in everything:
        if frames.intersection(finding.frames):
            assert any(each.rule == finding.rule and each.frames == finding.frames for each in told)
