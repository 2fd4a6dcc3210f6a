"""What commands have that the screen starts as processes of their own: they tell it when they are ready."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import click
import orjson

from bcapscope.live.standard_streams import print_stderr

attended_option = click.option(
    "--attended",
    is_flag=True,
    hidden=True,
    help="Write a line of JSON to stdout once all is ready, and end in order when stdin ends.",
)


def announce_ready(listening: Sequence[str], control: str = "") -> None:
    """Tell that these addresses are listened on now, and where it can be told what to do."""
    print_stderr("")  # all before it was the greeting
    told = {"listening": list(listening), "control": control}
    sys.stdout.buffer.write(orjson.dumps(told) + b"\n")
    sys.stdout.buffer.flush()
