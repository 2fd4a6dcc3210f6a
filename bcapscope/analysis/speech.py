"""Words for times, clients and calls, the same in all sentences."""

from __future__ import annotations

from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.traffic.call import Call
from bcapscope.traffic.observation import Conversation

LONGEST_NAME = 60
"""Characters of a string from the wire that a sentence holds."""

_MS = 1_000_000


def shown(text: str) -> str:
    """Shorten a string from the wire; it stays unescaped."""
    return text if len(text) <= LONGEST_NAME else text[:LONGEST_NAME] + "…"


def span(nanoseconds: int) -> str:
    """Write a duration with two or three digits that matter."""
    ms = nanoseconds / _MS
    if ms >= 999.5:
        return f"{ms / 1000:.3g} s" if ms < 999_500 else f"{ms / 1000:.0f} s"
    if ms >= 9.95:
        return f"{ms:.0f} ms"
    return f"{ms:.1f} ms" if ms >= 0.095 else f"{ms:.2f} ms"


def amount(value: float) -> str:
    """Write a measured number with three digits that matter, or all that stand before the point."""
    return f"{value:.0f}" if 999.5 <= abs(value) < 1e9 else f"{value:.3g}"


def times(count: int) -> str:
    """Write how often."""
    return {1: "once", 2: "twice"}.get(count, f"{count} times")


def name_of(call: Call) -> str:
    """Name what a call asks: its command, else its function."""
    command = call.kind.command
    return function_name(call.kind.function_id) if command is None else shown(command)


def called(call: Call) -> str:
    """Name a call by what it asks and its first serial."""
    return f"{name_of(call)} {call.request.item.serial}"


def result_text(code: int) -> str:
    """Write a result with its meaning."""
    name, number = hresult_name(code), f"0x{code:08X}"
    symbol = number if name == number else f"{name} {number}"
    return f"{symbol}, {describe_hresult(code).text}"


class Speech:
    """Says who and when, as far as the listener needs it."""

    def __init__(self, start: int, alone: bool) -> None:
        """Begin.

        Args:
            start: when the traffic began; times are told from there, as `decode` and `calls` tell them.
            alone: there is one client only.
        """
        self._start = start
        self._alone = alone

    def at(self, time: int) -> str:
        """Tell a moment."""
        return f"{(time - self._start) / 1e9:.3f} s"

    def client(self, conversation: Conversation) -> str:
        """Name a client."""
        if self._alone:
            return "your client"
        return f"client {conversation.client} ({conversation.transport.upper()})"
