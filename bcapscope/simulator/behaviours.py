"""The behaviours of the simulated controller, which are listed in the table in behaviours.md."""

from __future__ import annotations

from enum import StrEnum
from importlib import resources
from typing import NamedTuple


class Certainty(StrEnum):
    """How certain it is that a real controller behaves like the simulator."""

    DOCUMENTED = "documented"
    """A document or list from DENSO, or a published description of DENSO's commands, states the behaviour."""
    OBSERVED = "observed"
    """DENSO's server or driver, a published capture or a report of users shows the behaviour."""
    ASSUMED = "assumed"
    """No source states the behaviour, so the simulator assumes the most likely or the simplest behaviour."""


class Behaviour(NamedTuple):
    """A simulated behaviour: `text` is a clause about the controller, and `source` says how it is known."""

    name: str
    certainty: Certainty
    text: str
    source: str


def read_behaviours() -> tuple[Behaviour, ...]:
    text = resources.files("bcapscope.simulator").joinpath("behaviours.md").read_text(encoding="utf-8")
    _, _, table = text.partition("\n|---|---|---|---|\n")
    rows = (line.strip("| ").split(" | ") for line in table.splitlines())
    return tuple(
        Behaviour(name, Certainty(certainty), clause, source) for name, certainty, clause, source in rows
    )
