"""Text about two captures of the same conversation, taken at different places."""

from __future__ import annotations

from bcapscope.messages import Message
from bcapscope.traffic.joining.clock_estimate import ClockEstimate

_MS = 1e6


def places_message(near: str, far: str, clock: ClockEstimate) -> Message:
    """Return a message that says which capture was taken at which side, and how the two clocks differ.

    Args:
        near: Name of the capture from the client's side, escaped.
        far: Name of the capture from the controller's side, escaped.
    """
    offset, error = f"{clock.points[0][1] / _MS:+.3f}", f"{clock.error / _MS:.3f}"
    if clock.drift is None:
        return Message("reading.places", near=near, far=far, offset=offset, error=error)
    drift = f"{clock.drift * 1e6:+.1f}"
    return Message("reading.places.drift", near=near, far=far, offset=offset, error=error, drift=drift)
