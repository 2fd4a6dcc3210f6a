"""State of a proxy: everything that the screen asks for in one poll."""

from __future__ import annotations

import msgspec

from bcapscope.proxy.control_answers import Client, Figures, Held, Rule


class Standing(msgspec.Struct, frozen=True):
    """All of it."""

    clients: list[Client]
    rules: list[Rule]
    held: list[Held]
    figures: Figures
