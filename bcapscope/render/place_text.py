"""Text about captures of one conversation from two places."""

from __future__ import annotations

from pathlib import Path

from bcapscope.capture.place_plan import PlacePlan
from bcapscope.messages import Message
from bcapscope.render.escape import printable

_MS = 1e6


def place_plan_text(plan: PlacePlan) -> Message:
    """Return which capture was taken at which side, and how their clocks differ."""
    near, far = (printable(Path(file.path).name) for file in plan.files)
    clock = plan.clock
    offset, error = f"{clock.points[0][1] / _MS:+.3f}", f"{clock.error / _MS:.3f}"
    if clock.drift is None:
        return Message("reading.places", near=near, far=far, offset=offset, error=error)
    drift = f"{clock.drift * 1e6:+.1f}"
    return Message("reading.places.drift", near=near, far=far, offset=offset, error=error, drift=drift)
