"""The list that ``bcapscope sim --behaviours`` prints."""

from __future__ import annotations

import click

from bcapscope.cli.common.data_output import DataOutput
from bcapscope.render.columns import align_columns
from bcapscope.simulator.behaviours import BEHAVIOURS


def list_behaviours(context: click.Context, param: click.Parameter, wanted: bool) -> None:
    """Print each behaviour with its source and exit, if `wanted`."""
    if not wanted or context.resilient_parsing:
        return
    head = ("BEHAVIOUR", "CERTAINTY", "WHAT THE SIMULATOR DOES, OR WHEN IT RETURNS THE RESULT", "SOURCE")
    rows = [(each.name, each.certainty, each.text, each.source) for each in BEHAVIOURS]
    DataOutput().write_lines(align_columns([head, *rows], "<<<<"), lambda: None)
    context.exit()
