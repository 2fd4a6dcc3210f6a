"""The command line: one module per subcommand, imported when it is called.

Data goes to stdout, everything else to stderr; the exit codes are in `common.exit_codes`.
"""

from __future__ import annotations

import errno
import gc
import importlib
import io
import sys
from typing import Any

import click

from bcapscope import __version__
from bcapscope.cli.common.data_output import StdoutWriteError
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.errors import FileWriteError
from bcapscope.live.standard_streams import discard_stdout
from bcapscope.protocol.text_format import shortened
from bcapscope.render.escape import printable

_COMMANDS = {
    "decode": "Read frames, one line each.",
    "calls": "Pair requests, retries and replies: a line a call.",
    "diagnose": "Tell what went wrong, the first cause first.",
    "slave": "Slave mode: cycle times, retries, the controller's buffer, clock and motion.",
    "stats": "Figures by client and command: rates, latencies, retries, refusals.",
    "compare": "What differs between a good capture and a bad one.",
    "extract": "Write the trajectories of slave mode to CSV or JSON.",
    "report": "Write a page with findings, figures and pictures, to mail.",
    "call": "Call functions of a controller.",
    "ping": "Is a controller there, what is it, how fast does it answer?",
    "replay": "Play one side of a recorded session again.",
    "play": "Play a trajectory in slave mode.",
    "tui": "The screen: test a controller; traffic, live or from a file.",
    "proxy": "In the middle: see, record, disturb.",
    "sim": "A controller without a robot, to try things on.",
    "fields": "List the fields and the language of --filter.",
}


_DISK_FULL = {errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)}

_LONGEST_MESSAGE = 2000  # characters of an error, which may repeat what was typed

_GC_THRESHOLDS = (20_000, 20, 100)
"""How rarely to look for cycles: frames and calls hold none, and looking takes a twentieth of the time."""


class _UnwritableFileError(click.ClickException):
    """A file cannot be written; the message is free of control characters."""

    exit_code = ExitCode.UNWRITABLE


class _LazyGroup(click.Group):
    """Knows its commands by name and imports one only when it is called or asked for its help."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        module = importlib.import_module(f"bcapscope.cli.{cmd_name}")
        command = module.command
        assert isinstance(command, click.Command)
        return command

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; exit with `ExitCode.UNWRITABLE` if it cannot write a file."""
        try:
            return super().invoke(ctx)
        except FileWriteError as error:
            raise _UnwritableFileError(printable(str(error))) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(_COMMANDS.items()))


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="bcapscope", message="%(prog)s %(version)s")
def cli() -> None:
    """See what a b-CAP client and a DENSO robot controller say to each other, and why it went wrong."""


def main() -> None:
    """Run the command line and exit with an `ExitCode`."""
    gc.set_threshold(*_GC_THRESHOLDS)
    if sys.stdout is None or sys.stderr is None:  # closed by whoever started us
        if sys.stderr is not None:
            click.echo("Error: standard output is closed", err=True)
        sys.exit(ExitCode.UNWRITABLE)
    try:
        # Not by cli.main(): that ends with 1 when the reader of stdout has gone.
        with cli.make_context("bcapscope", sys.argv[1:]) as context:
            cli.invoke(context)
    except click.exceptions.Exit as end:
        sys.exit(end.exit_code)
    except click.ClickException as error:
        told = io.StringIO()
        error.show(told)
        click.echo(shortened(told.getvalue().rstrip("\n"), _LONGEST_MESSAGE), err=True)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        sys.exit(ExitCode.INTERRUPTED)
    except BrokenPipeError:  # the reader of stdout has seen enough
        discard_stdout()
    except OSError as error:
        if error.filename is not None or error.errno not in _DISK_FULL:
            raise
        discard_stdout()  # which has help or the version, as click writes them: all else sees to itself
        refused = StdoutWriteError(error)
        refused.show()
        sys.exit(refused.exit_code)
