"""State of a proxy: everything that the screen asks for in one poll."""

from __future__ import annotations

import msgspec

from bcapscope.proxy.control_messages import ClientStatus, FaultStatus, HeldStatus, ProxyStats


class ProxyState(msgspec.Struct, frozen=True):
    """All replies to one poll."""

    clients: list[ClientStatus]
    rules: list[FaultStatus]
    held: list[HeldStatus]
    figures: ProxyStats
