"""One frame that was captured at up to two places on its way between client and controller."""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum

from bcapscope.traffic.observation import Direction, Flow, Observation

_REQUEST = Direction.REQUEST


class CapturePlace(IntEnum):
    """A place where the frames of a conversation were captured."""

    CLIENT_SIDE = 0
    """A place at the client, or between client and proxy."""
    CONTROLLER_SIDE = 1
    """A place at the controller, or between proxy and controller."""


class JoinedObservation(Observation):
    """One frame of a conversation that was captured at two places. `at_client` and `at_controller` are the
    sightings at the two places; None if a place lacks the frame. The inherited fields come from `at_client`
    or, if `at_client` is None, from `at_controller`. The endpoints in `flow` are usually those at the
    client's side.

    Attributes:
        is_missed: Whether one place lacks the frame although traffic was being captured at both places.
        is_relayed: Whether a proxy is between the two places.
        note: What a proxy did to the frame; "" for nothing.
        delay_error: Uncertainty of `delay`, ns; 0 if both places have the same clock.
    """

    at_client: Observation | None
    at_controller: Observation | None
    is_missed: bool
    is_relayed: bool
    note: str
    delay_error: int

    @property
    def is_request(self) -> bool:
        return self.flow.direction is _REQUEST

    @property
    def was_lost_between(self) -> bool:
        """Whether the frame was lost between the two places: the receiver's side lacks it."""
        receiver = self.at_controller if self.is_request else self.at_client
        return self.is_missed and receiver is None

    @property
    def was_made_between(self) -> bool:
        """Whether a proxy made the frame: the capture at the sender's side lacks the frame."""
        sender = self.at_client if self.is_request else self.at_controller
        return self.is_missed and self.is_relayed and sender is None

    @property
    def delay(self) -> int | None:
        """Time from the sender's place to the receiver's place, ns; None if a place lacks the frame."""
        if self.at_client is None or self.at_controller is None:
            return None
        time = self.at_controller.time - self.at_client.time
        return time if self.is_request else -time

    @property
    def held_by_proxy(self) -> int:
        """Time in ns that the proxy took to forward the frame; 0 if unknown or without a proxy."""
        return (self.delay or 0) if self.is_relayed else 0

    def sightings(self) -> Iterator[Observation]:
        for sighting in (self.at_client, self.at_controller):
            if sighting is not None:
                yield sighting


def join_sightings(
    at_client: Observation | None,
    at_controller: Observation | None,
    flow: Flow,
    *,
    is_missed: bool = False,
    is_relayed: bool = True,
    note: str = "",
    delay_error: int = 0,
) -> JoinedObservation:
    """Join one or two sightings into one observation. `flow` is the flow at the client's side."""
    base = at_client or at_controller
    assert base is not None
    joined = JoinedObservation(base.number, base.time, base.first_byte_time, flow, base.item, base.packet)
    joined.at_client, joined.at_controller = at_client, at_controller
    joined.is_missed, joined.is_relayed, joined.note = is_missed, is_relayed, note
    joined.delay_error = delay_error
    return joined


def numbered(joined: JoinedObservation, number: int) -> JoinedObservation:
    """Return a copy of `joined` that has the frame number `number`. The frame of `joined` must have been
    captured only at the controller's side.
    """
    assert joined.at_client is None
    assert joined.at_controller is not None
    copy = joined._replace(number=number)
    vars(copy).update(vars(joined))
    copy.at_controller = joined.at_controller._replace(number=number)
    return copy


def sighting_numbers(observation: object) -> tuple[int, ...]:
    """Return the frame number at each place that captured the observation."""
    if isinstance(observation, JoinedObservation):
        return tuple(sighting.number for sighting in observation.sightings())
    return (observation.number,) if isinstance(observation, Observation) else ()
