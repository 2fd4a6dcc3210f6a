"""A rule's two plays: one in which it fires, one in which it has to stay silent."""

from __future__ import annotations

from typing import NamedTuple

from tests.analysis.scenes import Play


class Scene(NamedTuple):
    """What a rule has to do.

    Attributes:
        rule: its id.
        fires: a play in which it fires.
        frames: those that it names.
        words: what its sentence says, among other things.
        calm: a play that is nearly the same, in which it does not fire.
        cause: the rule of what it follows from in `fires`; empty where it is a first cause.
    """

    rule: str
    fires: Play
    frames: tuple[int, ...]
    words: tuple[str, ...]
    calm: Play
    cause: str = ""
