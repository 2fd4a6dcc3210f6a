"""Palettes of ANSI colour sequences for terminals."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Palette:
    """ANSI colour sequences. `reset` switches back to the default colour."""

    number: str = ""
    name: str = ""
    hex: str = ""
    problem: str = ""
    good: str = ""
    bad: str = ""
    dim: str = ""
    reset: str = ""


PLAIN = Palette()  # no colours: used for a pipe or a file, or if NO_COLOR is set

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
"""Palette of standard terminal colours that are readable on dark and on light backgrounds."""
