"""Coloring rules for Wireshark's packet list."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.protocol.tables.hresult import S_BUF_FULL, S_EXECUTING


class _ColoringRule(NamedTuple):
    """A coloring rule. Wireshark colors a packet by the first rule whose display filter matches the packet.

    Attributes:
        background: Red, green and blue from 0 to 255. In Wireshark's file, these numbers are scaled to 0 to
            65535.
    """

    name: str
    display_filter: str
    background: tuple[int, int, int]
    text: tuple[int, int, int] = (18, 39, 46)


_RULES = (
    _ColoringRule("b-CAP damaged", "bcap.problems", (120, 28, 34), (255, 240, 200)),
    _ColoringRule(
        "b-CAP failed",
        "bcap.hresult >= 0x80000000 || (bcap.hresult >= 0x1000 && bcap.hresult <= 0xffff)",
        (247, 186, 186),
    ),
    _ColoringRule("b-CAP buffer full", f"bcap.hresult == 0x{S_BUF_FULL:08x}", (255, 222, 173)),
    _ColoringRule("b-CAP retry", "bcap.retry_of", (255, 243, 176)),
    _ColoringRule("b-CAP still executing", f"bcap.hresult == 0x{S_EXECUTING:x}", (226, 226, 226)),
    _ColoringRule("b-CAP reply", 'bcap.kind == "response"', (222, 240, 222)),
    _ColoringRule("b-CAP request", "bcap", (218, 232, 250)),
)


def coloring_rules_text() -> str:
    """Return the rules as a file that Wireshark imports under View > Coloring Rules."""
    lines = [
        f"@{rule.name}@{rule.display_filter}@{_color(rule.background)}{_color(rule.text)}" for rule in _RULES
    ]
    return "\n".join(("# Coloring rules for b-CAP, written by bcapscope", *lines, ""))


def _color(levels: tuple[int, int, int]) -> str:
    return f"[{','.join(str(level * 257) for level in levels)}]"
