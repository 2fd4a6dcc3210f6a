"""Asking whether a robot may move."""

from __future__ import annotations

import sys

import click

from bcapscope.render.escape import printable


def can_ask() -> bool:
    """Tell whether there is somebody to ask: both ends are a terminal."""
    return sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()


def confirmed(host: str) -> bool:
    """Let the user type the controller's address, which nobody does by accident.

    Raises:
        click.Abort: by Ctrl-C, or the end of what is typed.
    """
    typed: str = click.prompt(f"Type {printable(host)} if it may", default="", show_default=False, err=True)
    return typed.strip() == host
