"""Colours: the ANSI sequences that renderers put before a piece of text, or nothing."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Palette:
    """A sequence for each kind of text; `reset` ends what any of them began. Without colours, all are
    empty.
    """

    number: str = ""
    name: str = ""
    hex: str = ""
    problem: str = ""
    good: str = ""
    bad: str = ""
    dim: str = ""
    reset: str = ""


PLAIN = Palette()
"""No colours: for pipes, files and NO_COLOR."""

ANSI = Palette(
    number="\x1b[36m",
    name="\x1b[1m",
    hex="\x1b[34m",
    problem="\x1b[1;31m",
    good="\x1b[32m",
    bad="\x1b[31m",
    dim="\x1b[2m",
    reset="\x1b[0m",
)
"""The eight colours that every terminal has, chosen to read on dark and light grounds."""
