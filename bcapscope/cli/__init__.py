"""The command line: one module per command. Data goes to stdout, all other text to stderr."""

from __future__ import annotations

import errno
import gc
import importlib
import io
import sys
from typing import Any

import click

from bcapscope import __version__
from bcapscope.cli.common.data_output import OutputError, discarded_stdout
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.errors import FileWriteError
from bcapscope.live.standard_streams import discard_stdout
from bcapscope.protocol.text_format import shortened
from bcapscope.render.escape import printable

_COMMANDS = {
    "decode": "Decode frames, one line each.",
    "calls": "Show calls: each request with its retries and reply, one line per call.",
    "diagnose": "Explain what went wrong, root cause first.",
    "slave": "Show slave-mode sessions: cycle times, retries, buffer, clock and motion.",
    "stats": "Show figures by client and command: rates, latencies, retries, refusals.",
    "compare": "Compare a good capture with a bad one.",
    "extract": "Write slave-mode trajectories to CSV or JSON.",
    "report": "Write one HTML page with findings, figures and charts.",
    "call": "Call functions of a controller.",
    "ping": "Check that a controller answers, and how fast.",
    "replay": "Play one side of a recording again.",
    "play": "Move a robot along a trajectory in slave mode.",
    "tui": "Open the screen: test a controller, show live traffic or a capture.",
    "proxy": "Proxy: watch, record and disturb live traffic.",
    "sim": "Simulate a controller without a robot.",
    "wireshark": "Decode and capture b-CAP in Wireshark.",
    "fields": "List the fields of --filter and explain its syntax.",
}

_HIDDEN_COMMANDS = {"extcap"}
"""Commands that other programs start, and that the help does not list."""

_DISK_FULL = {errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)}

_LONGEST_MESSAGE = 2000  # maximum number of characters of an error message, which can quote the command line

_GC_THRESHOLDS = (20_000, 20, 100)
"""Thresholds at which the garbage collector runs rarely: frames and calls form no reference cycles. With
lower thresholds, garbage collection took 5 % of the run time.
"""


class _LazyGroup(click.Group):
    """Imports the module of a command only when the command runs or shows its help."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS and cmd_name not in _HIDDEN_COMMANDS:
            return None
        command = importlib.import_module(f"bcapscope.cli.{cmd_name}").command
        assert isinstance(command, click.Command)
        command.short_help = _COMMANDS.get(cmd_name)
        return command

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command, and exit with `ExitCode.UNWRITABLE` if the command cannot write a file."""
        try:
            return super().invoke(ctx)
        except FileWriteError as error:
            raise OutputError(printable(str(error))) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(_COMMANDS.items()))


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "show_default": True})
@click.version_option(__version__, prog_name="bcapscope", message="%(prog)s %(version)s")
def cli() -> None:
    """Decode, explain, test and simulate b-CAP, the protocol of DENSO robot controllers.

    `bcapscope COMMAND --help` lists the options of a command.
    """


def main() -> None:
    gc.set_threshold(*_GC_THRESHOLDS)
    if sys.stdout is None or sys.stderr is None:  # closed by the parent process
        if sys.stderr is not None:
            click.echo("Error: standard output is closed", err=True)
        sys.exit(ExitCode.UNWRITABLE)
    try:
        # `cli.main()` is not used: it would exit with 1 when the reader of stdout closes the pipe.
        with cli.make_context("bcapscope", sys.argv[1:]) as context:
            cli.invoke(context)
    except click.exceptions.Exit as end:
        sys.exit(end.exit_code)
    except click.ClickException as error:
        message = io.StringIO()
        error.show(message)
        click.echo(shortened(message.getvalue().rstrip("\n"), _LONGEST_MESSAGE), err=True)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        sys.exit(ExitCode.INTERRUPTED)
    except BrokenPipeError:  # the reader closed stdout, as `head` does
        discard_stdout()
    except OSError as error:
        if error.filename is not None or error.errno not in _DISK_FULL:
            raise
        # click failed to write the help or the version; commands handle their own errors
        discarded_stdout(error).show()
        sys.exit(ExitCode.UNWRITABLE)
