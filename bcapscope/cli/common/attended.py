"""Options and reports of commands that the screen runs as child processes."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from io import FileIO
from typing import TYPE_CHECKING

import click
import orjson

from bcapscope.cli.common.options import parsed_by
from bcapscope.live.standard_streams import print_stderr

if TYPE_CHECKING:
    from bcapscope.live.proxy_options import WatcherSubscriber

attended_option = click.option(
    "--attended",
    is_flag=True,
    hidden=True,
    help="Print a line of JSON to stdout when the command is ready, and end cleanly when stdin ends.",
)


def open_publisher(job: str) -> WatcherSubscriber:
    """Return a publisher that sends the decoded traffic to the screen. `job` is a `ReadJob` as JSON."""
    import msgspec

    from bcapscope.tui.traffic_processes.process_messages import ReadJob
    from bcapscope.tui.traffic_processes.watcher_publisher import ReportSender, WatcherPublisher

    stdout = FileIO(1, "wb", closefd=False)
    return WatcherPublisher(msgspec.json.decode(job, type=ReadJob), ReportSender(stdout))


publish_option = click.option(
    "--publish",
    "open_subscriber",
    metavar="JOB",
    hidden=True,
    callback=parsed_by(lambda job: partial(open_publisher, job)),
    help="Publish the traffic to the screen that started this command; JOB is a ReadJob in JSON.",
)


def announce_ready(listening: Sequence[str], control: str = "") -> None:
    """Print a line of JSON with the listening addresses and the address of the control socket."""
    print_stderr("")  # an empty line marks the end of the greeting for the parent process
    report = {"listening": list(listening), "control": control}
    sys.stdout.buffer.write(orjson.dumps(report) + b"\n")
    sys.stdout.buffer.flush()
