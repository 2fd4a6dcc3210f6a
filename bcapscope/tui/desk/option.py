"""The Option field of the connection: ``Timeout=300`` and the like, as b-CAP Tester has it.

What stands there is for us, for Service_Start or for Controller_Connect; its key tells which.
"""

from __future__ import annotations

from dataclasses import replace

from bcapscope.client.target import Target
from bcapscope.protocol.convention import Convention
from bcapscope.tui.words import say

_FOR_SERVICE = ("wdt", "invoketimeout")
_ON_UDP = (Convention.SEED, Convention.OWN, Convention.CHAIN)
_ON_TCP = (Convention.TCP0, Convention.TCP1)

AUTOMATIC = ("CaoProv.DENSO.VRC", "CaoProv.DENSO.VRC9", "")
"""Providers that are tried one after the other where none is named: that of RC8 and COBOTTA, that of RC9 and
COBOTTA PRO, none. RC7 takes the first, as it ignores the name."""


def read_option(text: str, host: str, port: int, tcp: bool) -> tuple[Target, tuple[str, ...]]:
    """Read the field.

    Args:
        text: pairs of key and value, commas between; empty for the usual.
        host: of the controller.
        port: of the controller.
        tcp: TCP instead of UDP.

    Returns:
        The target, and the providers to be tried.

    Raises:
        ValueError: with the part that makes no sense, and what is expected.
    """
    target = Target(host, port, tcp, name="")
    providers: tuple[str, ...] = AUTOMATIC
    for part in filter(None, (each.strip() for each in text.split(","))):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        folded = key.casefold()
        if key.startswith("@") or folded in ("interval", "server"):
            target = replace(target, connect_option=",".join(filter(None, (target.connect_option, part))))
        elif not equals:
            raise ValueError(say("desk.option.pair", part=part, help=say("desk.option.help")))
        elif folded in _FOR_SERVICE:
            _whole(key, value, 80, 10_000_000)
            target = replace(target, service=f"{target.service},{key}={value}")
        elif folded == "provider":
            providers = (value,)
        else:
            target = _own(target, key, value)
    return replace(target, provider=providers[0]), providers


def _own(target: Target, key: str, value: str) -> Target:
    folded = key.casefold()
    if folded == "timeout":
        return replace(target, timeout=float(_whole(key, value, 1, 600_000)))
    if folded in ("retry", "retries"):
        return replace(target, retries=_whole(key, value, 0, 100))
    if folded == "machine":
        return replace(target, machine=value)
    if folded == "name":
        return replace(target, name=value)
    if folded == "reserved":
        return replace(target, convention=_convention(value, target.tcp))
    raise ValueError(say("desk.option.unknown", key=key, help=say("desk.option.help")))


def _whole(key: str, value: str, low: int, high: int) -> int:
    number = int(value) if value.isascii() and value.isdecimal() and len(value) < 12 else -1
    if not low <= number <= high:
        raise ValueError(say("desk.option.whole", key=key, value=value, low=low, high=high))
    return number


def _convention(value: str, tcp: bool) -> Convention:
    allowed = [each.value for each in (_ON_TCP if tcp else _ON_UDP)]
    if value.casefold() not in allowed:
        raise ValueError(say("desk.option.reserved", value=value, allowed=", ".join(allowed)))
    return Convention(value.casefold())
