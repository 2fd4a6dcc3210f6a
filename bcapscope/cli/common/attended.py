"""How commands that the screen starts as processes report that they are ready."""

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
    help="Print a line of JSON to stdout when the command is ready, and end cleanly when stdin ends.",
)

publish_option = click.option(
    "--publish",
    "published",
    metavar="JOB",
    hidden=True,
    help="Publish the traffic to the screen that started this command; JOB is a ReadJob in JSON.",
)


def announce_ready(listening: Sequence[str], control: str = "") -> None:
    """Print the addresses that the command listens on, and that of its control socket."""
    print_stderr("")  # ends the greeting for the parent process
    report = {"listening": list(listening), "control": control}
    sys.stdout.buffer.write(orjson.dumps(report) + b"\n")
    sys.stdout.buffer.flush()
