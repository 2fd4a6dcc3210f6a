"""What passes without the scripts: stops always, and while the scripts are off all but motion."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from bcapscope.protocol.effects import Effect
from bcapscope.protocol.frame import Frame, Malformed
from bcapscope.protocol.guard import always_passes, request_effect


class Unscripted(NamedTuple):
    """A request that no script has seen.

    Attributes:
        passing: the bytes that go on.
        refused: the frames that would move something.
    """

    passing: bytes
    refused: tuple[Frame, ...]


def is_stop(frames: Iterable[Frame]) -> bool:
    """Return whether frames stop the robot or release something, and do nothing else."""
    found = tuple(frames)
    return bool(found) and all(not each.problems and _always_passes(each) for each in found)


def without_motion(items: Iterable[Frame | Malformed]) -> Unscripted:
    """Part what moves, or may, from the rest of a request."""
    passing, refused = [], []
    for item in items:
        if isinstance(item, Frame) and _moves(item):
            refused.append(item)
        else:
            passing.append(item.raw)
    return Unscripted(b"".join(passing), tuple(refused))


def _moves(frame: Frame) -> bool:
    return not _always_passes(frame) and request_effect(frame.code, frame.variants) >= Effect.MOVES


def _always_passes(frame: Frame) -> bool:
    return always_passes(frame.code, frame.variants)
