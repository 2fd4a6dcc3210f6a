"""Compare frames to recognise whether two conversations are the legs of one conversation through a proxy."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from bcapscope.traffic.observation import Conversation, Direction, Observation

ENOUGH_CALLS = 8
"""Minimum number of nested calls (see `NestedCalls`) for joining two conversations immediately, before the
joiner has held them for the full time. Two clients that run the same program at the same time without a proxy
send equal frames, but they are very unlikely to produce this number of nested calls by chance.
"""

FEWEST_CALLS = 2
"""Minimum number of nested calls (see `NestedCalls`) for joining two conversations after the joiner has held
them for some time. If addresses or interface names suggest a proxy, one nested call is enough.
"""

CLIENT_LEG, CONTROLLER_LEG = "clients of ", "controller "
"""How interface names begin in a recording of bcapscope's proxy: one prefix for each leg."""

_REQUEST = Direction.REQUEST


class NestedCalls(NamedTuple):
    """The nested calls of two conversations. Nested calls show that a proxy forwarded the frames.

    A nested call occurs with equal bytes in two conversations, an outer and an inner one. The outer
    conversation has the request earlier and the reply later than the inner conversation. With a proxy, the
    outer conversation is the client's leg, and the inner conversation is the controller's leg. The proxy
    receives a request on the client's leg before it sends the request on the controller's leg. It receives
    the reply on the controller's leg before it sends the reply on the client's leg.

    Attributes:
        calls: Number of nested calls: the number of common requests or of common replies, whichever is less.
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
    """Return the minimum number of nested calls (see `NestedCalls`) that proves that `outer` and `inner` are
    the two legs of a proxy. Return None if the interface names show that they are not.
    """
    if any(each.interface.startswith((CLIENT_LEG, CONTROLLER_LEG)) for each in (outer, inner)):
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
