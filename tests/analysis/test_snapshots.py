"""A diagnosis can be asked at any time: it answers as if the traffic ended then, and nothing changes."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import pytest

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.capture.capture_file import CaptureFile
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.errors import CaptureError
from bcapscope.traffic.call import Call
from bcapscope.traffic.filter.compiler import compile_filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.filter.getters import CALL_GETTERS
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.pipeline import Pipeline, PipelineSubscriber
from tests.analysis.plays import SCENES
from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import Story
from tests.traffic.playbook import run_pipeline

CAPTURES = sorted(Path(__file__).parents[2].joinpath("captures").glob("*.pcap*"))
SILENCE_NS = 15_000_000_000
"""Long enough for every rule about silent clients."""


def observed(capture: bytes) -> Iterator[Observation]:
    """Decode bit by bit: what a conversation says about its end must not come from later packets."""
    try:
        yield from PacketDecoder(frozenset({5007})).decode(CaptureFile(io.BytesIO(capture)))
    except CaptureError:
        return


class Listener:
    """Diagnoses observations one by one."""

    def __init__(self, is_selected: Callable[[Call], bool] | None) -> None:
        self.sessions: list[SlaveSession] = []
        self.diagnosis = Diagnosis(is_selected, self.sessions.append)
        self.pipeline = Pipeline(self.diagnosis)
        self.now = 0

    def observe(self, observation: Observation) -> None:
        self.now = observation.time
        self.pipeline.add(observation)

    def close(self) -> None:
        self.pipeline.finish()

    def answers(self) -> tuple[str, ...]:
        """Return all answers of the diagnosis as text, since NaN does not equal itself."""
        found = []
        for ended_at, present in ((0, False), (self.now + SILENCE_NS, False), (self.now + SILENCE_NS, True)):
            remaining = self.diagnosis.remaining_sessions(ended_at)
            found += [repr(each) for each in self.diagnosis.findings(ended_at, present)]
            found += [repr(self.diagnosis.totals(ended_at)), repr([*self.sessions, *remaining])]
        return tuple(found)


def ask_now_and_then(capture: bytes, expression: str) -> None:
    """Compare a diagnosis that is asked now and then with others that are asked once."""
    chosen = compile_filter(expression, RecordKind.CALL).bind(CALL_GETTERS) if expression else None
    count = sum(1 for _ in observed(capture))
    asked = Listener(chosen)
    cuts = {count // 4, count // 2, count - 1}
    for number, observation in enumerate(observed(capture), 1):
        asked.observe(observation)
        if number in cuts:
            fresh = Listener(chosen)
            for earlier in islice(observed(capture), number):
                fresh.observe(earlier)
            assert asked.answers() == fresh.answers() == asked.answers()
    never_asked = Listener(chosen)
    for observation in observed(capture):
        never_asked.observe(observation)
    asked.close()
    never_asked.close()
    assert asked.answers() == never_asked.answers()


@pytest.mark.parametrize("expression", ["", "hresult != 0"])
@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.rule)
def test_a_scene_that_is_asked_about_ends_as_one_that_is_not(scene: Scene, expression: str) -> None:
    story = Story()
    scene.fires(story)
    ask_now_and_then(story.capture(), expression)


@pytest.mark.parametrize("expression", ["", "command == slvMove"])
@pytest.mark.parametrize("path", CAPTURES, ids=lambda path: path.name)
def test_a_capture_that_is_asked_about_ends_as_one_that_is_not(path: Path, expression: str) -> None:
    ask_now_and_then(path.read_bytes(), expression)


def test_occurrences_that_wait_for_their_call_are_not_lost_when_asked_about() -> None:
    """The filter selects the call of a large frame. The diagnosis is asked before the call is complete."""
    (scene,) = (scene for scene in SCENES if scene.rule == "near-datagram-limit")
    story = Story()
    scene.fires(story)
    diagnosis = Diagnosis(lambda call: True)

    class Asker(PipelineSubscriber):
        def on_frame(self, observation: Observation) -> None:
            diagnosis.findings()

    run_pipeline(observed(story.capture()), diagnosis, Asker())
    assert "near-datagram-limit" in [finding.rule for finding in diagnosis.findings()]


def test_announcements_do_not_depend_on_what_was_asked() -> None:
    """`new_findings` announces what live rules find, and not what a snapshot adds."""
    announced = []
    for asks in (True, False):
        (scene,) = (scene for scene in SCENES if scene.rule == "client-stopped")
        story = Story()
        scene.fires(story)
        listener = Listener(None)
        rules = []
        for observation in observed(story.capture()):
            listener.observe(observation)
            if asks:
                listener.answers()
            rules += [finding.rule for finding in listener.diagnosis.new_findings()]
        announced.append(rules)
    assert announced[0] == announced[1]
