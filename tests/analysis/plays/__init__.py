"""Plays for every rule of a diagnosis, by the rules' modules."""

from __future__ import annotations

from tests.analysis.plays import (
    errors,
    limits,
    motion,
    objects,
    pacing,
    polling,
    preparation,
    proxy,
    replies,
    requests,
    retries,
    session,
    slavemode,
    wire,
)
from tests.analysis.plays.scene import Scene

SCENES: tuple[Scene, ...] = (
    *(*errors.SCENES, *limits.SCENES, *motion.SCENES, *objects.SCENES, *pacing.SCENES, *polling.SCENES),
    *(*preparation.SCENES, *replies.SCENES, *requests.SCENES, *retries.SCENES, *session.SCENES),
    *(*slavemode.SCENES, *wire.SCENES, *proxy.SCENES),
)
"""At least one for each rule."""
