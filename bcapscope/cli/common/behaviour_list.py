"""What ``bcapscope sim --behaviours`` lists."""

from __future__ import annotations

import click

from bcapscope.cli.common.data_output import DataOutput
from bcapscope.render.columns import align_columns
from bcapscope.simulator.behaviours import BEHAVIOURS


def list_behaviours(context: click.Context, param: click.Parameter, wanted: bool) -> None:
    """Write each behaviour with where we have it from and end, if that is wanted."""
    if not wanted or context.resilient_parsing:
        return
    head = ("BEHAVIOUR", "CERTAINTY", "WHAT IS DONE, OR WHAT THE RESULT ANSWERS", "SOURCE")
    rows = [(each.name, each.certainty, each.text, each.source) for each in BEHAVIOURS]
    DataOutput().write_lines(align_columns([head, *rows], "<<<<"), lambda: None)
    context.exit()
