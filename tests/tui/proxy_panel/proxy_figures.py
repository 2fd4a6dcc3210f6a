"""Figures of a proxy, made up."""

from __future__ import annotations

from typing import Any

from bcapscope.proxy.control_messages import ProxyStats

_NOTHING: dict[str, Any] = {
    "injected": {},
    "refused": 0,
    "guard": False,
    "intercept": None,
    "held": 0,
    "held_so_far": 0,
    "addon_errors": 0,
    "scripts": None,
}


def figures(**given: Any) -> ProxyStats:
    """Return figures of a proxy where nothing has happened except what is given."""
    return ProxyStats(**_NOTHING | given)
