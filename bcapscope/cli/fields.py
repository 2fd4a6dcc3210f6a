"""``bcapscope fields``: list the fields and the syntax of filters."""

from __future__ import annotations

import click

from bcapscope.cli.common.data_output import write_lines
from bcapscope.render.columns import align_columns
from bcapscope.traffic.filter import compiler
from bcapscope.traffic.filter.field_table import FIELDS, RecordKind

_KIND_NAMES: dict[tuple[RecordKind, ...], str] = {(RecordKind.FRAME,): "frames", (RecordKind.CALL,): "calls"}


@click.command()
def command() -> None:
    """List the fields that --filter can use, with their types, and explain the syntax of filters.

    Each line describes one field: its name, its owner (frames, calls or both), its type and its meaning.
    """
    rows = [
        (field.name, _KIND_NAMES.get(field.applies_to, "both"), field.type.value, field.meaning)
        for field in FIELDS
    ]
    write_lines([*align_columns(rows, "<<<<"), "", *(compiler.__doc__ or "").strip().splitlines()])
