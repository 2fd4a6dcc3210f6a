"""The bar of views, where it is too narrow for all of them."""

from __future__ import annotations

import pytest
from textual.pilot import Pilot

from bcapscope.tui.widgets.bars import ViewBar
from tests.tui.widgets.stage import on_stage

VIEWS = {"frames": "traffic.frames", "calls": "traffic.calls", "findings": "traffic.findings"}


@pytest.mark.parametrize("width", [20, 28, 34])
def test_views_that_do_not_fit_are_cut_off_at_the_edge(width: int) -> None:
    async def act(pilot: Pilot[None]) -> None:
        bar = pilot.app.screen.query_one(ViewBar)
        bar.show_counts("frames", {"frames": "4,493", "calls": "2,010"}, ())
        whole = " 1 Frames 4,493  2 Calls 2,010  3 Findings "
        assert bar.render_line(0).text == whole[:width]

    on_stage(lambda: ViewBar(VIEWS), act, (width, 24))
