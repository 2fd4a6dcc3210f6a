"""Columns of the list of frames."""

from __future__ import annotations

from bcapscope.tui.widgets.framelist import left, right


def test_wide_characters_take_two_columns() -> None:
    assert left("客", 4) + "|" == "客  |"
    assert right("客", 4) == "  客"
