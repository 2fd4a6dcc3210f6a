"""The field for bytes of the Tester."""

from __future__ import annotations

from textual.events import Paste
from textual.pilot import Pilot

from bcapscope.tui.tester.call_forms import BytesField
from tests.tui.widgets.stage import on_stage


def test_pasted_lines_become_one() -> None:
    async def act(pilot: Pilot[None]) -> None:
        field = pilot.app.query_one(BytesField)
        field.focus()
        await pilot.pause()
        field.post_message(Paste("01 10 00 00\r\n00 01\n"))
        await pilot.pause()
        assert field.value == "01 10 00 00 00 01"

    on_stage(BytesField, act)
