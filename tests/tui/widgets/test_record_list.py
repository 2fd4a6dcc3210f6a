"""Columns of the list of frames."""

from __future__ import annotations

from bcapscope.tui.widgets.record_lists import left_aligned, right_aligned


def test_wide_characters_take_two_columns() -> None:
    assert left_aligned("客", 4) + "|" == "客  |"
    assert right_aligned("客", 4) == "  客"
