"""Findings on a screen of 80 columns, in Japanese."""

from __future__ import annotations

from textual.pilot import Pilot

from bcapscope.messages import Language
from bcapscope.protocol.text_format import display_width
from bcapscope.tui.reader_language import set_language
from bcapscope.tui.traffic_processes.process_messages import TrafficAnalysis
from bcapscope.tui.traffic_processes.running_diagnosis import shown_finding
from bcapscope.tui.widgets.finding_page import FindingPage
from tests.analysis.plays import SCENES
from tests.analysis.scenes import stage
from tests.tui.marks import strip_styles
from tests.tui.pilot import shown
from tests.tui.widgets.stage import on_stage, scope


def test_nothing_of_a_finding_is_cut_off() -> None:
    found = [stage(scene.fires) for scene in SCENES[::8]]
    causes = tuple(shown_finding(each, story.seen) for story in found for each in story.findings)

    async def act(pilot: Pilot[None]) -> None:
        page = pilot.app.screen.query_one(FindingPage)
        set_language(Language.JAPANESE)
        page.show_analysis(TrafficAnalysis(causes, found[0].seen, [], []))
        await pilot.pause()
        assert "対処" in shown(scope(pilot))
        lines = [strip_styles(page.line(index)) for index in range(page.count)]
        assert [line for line in lines if display_width(line) > 80] == []

    on_stage(FindingPage, act)
