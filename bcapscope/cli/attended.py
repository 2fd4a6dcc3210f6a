"""What commands have that the screen starts as processes of their own: they tell it when they are ready."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import click
import orjson

attended_option = click.option(
    "--attended",
    is_flag=True,
    hidden=True,
    help="Write a line of JSON to stdout once all is ready, and end in order when stdin ends.",
)


def announce(addresses: Sequence[str]) -> None:
    """Tell that these addresses are listened on now."""
    sys.stdout.buffer.write(orjson.dumps(list(addresses)) + b"\n")
    sys.stdout.buffer.flush()
