"""``bcapscope tui --serve``: the screen in a browser, on this machine only."""

from __future__ import annotations

import shlex
import socket
import subprocess
import sys
from collections.abc import Sequence

import click

from bcapscope.cli.exits import Exit
from bcapscope.cli.output import narrate

HOST = "127.0.0.1"
"""Whoever opens the page can move a robot and nobody is asked for a password: no other machine reaches it."""

PORT = 8000
_FLAG = "--serve"


def _serve(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    """Serve the same command without the option, until Ctrl-C."""
    if not value or context.resilient_parsing:
        return
    try:
        from textual_serve.server import Server
    except ImportError:
        narrate("textual-serve is not installed; pip install 'bcapscope[serve]'")
        sys.exit(Exit.NOT_INSTALLED)
    if trouble := _trouble():
        narrate(f"http://{HOST}:{PORT}/ cannot be served: {trouble}")
        sys.exit(Exit.UNREADABLE)
    narrate(f"http://{HOST}:{PORT}/ shows the screen; only this machine reaches it; Ctrl-C ends")
    Server(command_line(sys.argv[1:]), HOST, PORT, "bcapscope").serve()
    context.exit()


def command_line(words: Sequence[str]) -> str:
    """Write the command that runs the screen itself, for a shell."""
    argv = [sys.executable, "-m", "bcapscope", *(word for word in words if word != _FLAG)]
    return subprocess.list2cmdline(argv) if sys.platform == "win32" else shlex.join(argv)


def _trouble() -> str:
    """Say why the port cannot be listened on; "" where it can."""
    with socket.socket() as probe:
        try:
            if sys.platform != "win32":
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((HOST, PORT))
        except OSError as error:
            return (error.strerror or str(error)).lower()
    return ""


serve_option = click.option(
    _FLAG,
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_serve,
    help=f"Show it in a browser instead, at http://{HOST}:{PORT}/.",
)
