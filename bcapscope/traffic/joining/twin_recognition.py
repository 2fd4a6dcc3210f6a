"""Compare frames to recognise whether two conversations are the legs of one conversation through a proxy."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from bcapscope.traffic.observation import Conversation, Direction, Observation

ENOUGH_CALLS = 8
"""Number of nested calls (see `NestedCalls`) for joining two conversations immediately. Without a proxy, two
clients that start the same program together are very unlikely to produce this number of nested calls.
"""

FEWEST_CALLS = 2
"""Minimum number of nested calls for joining two conversations after a waiting time."""

CLIENT_LEG, CONTROLLER_LEG = "clients of ", "controller "
"""How interface names begin in a recording of bcapscope's proxy: one prefix for each leg."""

_REQUEST = Direction.REQUEST


class NestedCalls(NamedTuple):
    """How well the calls of an inner conversation are nested in the calls of an outer conversation. A proxy's
    controller leg is an inner conversation, and its client leg is the outer conversation.

    Equal bytes identify the same frame in both conversations. In a nested call, the outer request comes
    before the inner request, and the inner reply comes before the outer reply.

    Attributes:
        lag: Total time in ns that requests took from the outer to the inner conversation.
        is_contradicted: Whether a request came first in the inner conversation, or a reply came first in the
            outer conversation.
    """

    calls: int
    lag: int
    is_contradicted: bool

    def proves_twins(self, fewest: int) -> bool:
        return not self.is_contradicted and self.calls >= fewest


def nested_calls(outer: Iterable[Observation], inner: Iterable[Observation]) -> NestedCalls:
    requests, replies = _first_times(outer)
    inner_requests, inner_replies = _first_times(inner)
    lags = [time - requests[raw] for raw, time in inner_requests.items() if raw in requests]
    leads = [replies[raw] - time for raw, time in inner_replies.items() if raw in replies]
    is_contradicted = any(lag < 0 for lag in lags) or any(lead < 0 for lead in leads)
    return NestedCalls(min(len(lags), len(leads)), sum(lags), is_contradicted)


def may_be_twins(one: Conversation, other: Conversation) -> bool:
    return one.transport is other.transport and one.server != other.server


def fewest_calls(outer: Conversation, inner: Conversation) -> int | None:
    """Return how many nested calls prove two legs of a proxy; None if the interface names exclude a proxy."""
    if outer.interface.startswith(CLIENT_LEG) or inner.interface.startswith(CONTROLLER_LEG):
        are_legs = outer.interface.startswith(CLIENT_LEG) and inner.interface.startswith(CONTROLLER_LEG)
        return 1 if are_legs else None
    is_same_host = outer.server.host == inner.client.host != outer.client.host
    return 1 if is_same_host else FEWEST_CALLS


def _first_times(observations: Iterable[Observation]) -> tuple[dict[bytes, int], dict[bytes, int]]:
    requests: dict[bytes, int] = {}
    replies: dict[bytes, int] = {}
    for each in observations:
        times = requests if each.flow.direction is _REQUEST else replies
        times.setdefault(each.item.raw, each.time)
    return requests, replies
