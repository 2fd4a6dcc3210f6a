"""The behaviours of the simulated controller, read from the table in behaviours.md."""

from __future__ import annotations

from enum import StrEnum
from importlib import resources
from typing import NamedTuple


class Certainty(StrEnum):
    """Degree of certainty that a real controller behaves like the simulator."""

    DOCUMENTED = "documented"
    """The vendor's documents or lists, or published descriptions of its commands, state the behaviour."""
    OBSERVED = "observed"
    """The behaviour was seen in the vendor's server or driver or in dumps, or was reported by users."""
    ASSUMED = "assumed"
    """No source states the behaviour; it is the likeliest one, or the simplest one that works."""


class Behaviour(NamedTuple):
    """A simulated behaviour: one clause that says what the controller does, and the source of this fact."""

    name: str
    certainty: Certainty
    text: str
    source: str


def read_behaviours() -> tuple[Behaviour, ...]:
    """Return every simulated behaviour; behaviours that depend on the profile come first."""
    text = resources.files("bcapscope.simulator").joinpath("behaviours.md").read_text(encoding="utf-8")
    _, _, table = text.partition("\n|---|---|---|---|\n")
    rows = (line.strip("| ").split(" | ") for line in table.splitlines())
    return tuple(
        Behaviour(name, Certainty(certainty), clause, source) for name, certainty, clause, source in rows
    )
