"""``bcapscope fields``: what a filter can ask for."""

from __future__ import annotations

import click

from bcapscope.cli.output import Output
from bcapscope.render.columns import columns
from bcapscope.traffic import filters
from bcapscope.traffic.fields import FIELDS, RecordKind

_OF: dict[tuple[RecordKind, ...], str] = {(RecordKind.FRAME,): "frames", (RecordKind.CALL,): "calls"}


@click.command(short_help="List the fields and the language of --filter.")
def command() -> None:
    """List the fields that --filter knows, and explain its language."""
    output = Output()
    rows = [
        (field.name, _OF.get(field.applies_to, "both"), field.type.value, field.meaning) for field in FIELDS
    ]
    lines = list(columns(rows, "<<<<"))
    output.write_lines([*lines, "", *(filters.__doc__ or "").strip().splitlines()], lambda: None)
