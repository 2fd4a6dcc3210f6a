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
    return Message(
        "reading.places",
        near=near,
        far=far,
        offset=f"{clock.points[0][1] / _MS:+.3f}",
        error=f"{clock.error / _MS:.3f}",
        drift=f"{clock.drift * 1e6:+.1f}",
    )
