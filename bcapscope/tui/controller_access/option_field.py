"""Parses the text in the Option field of the connection form. b-CAP Tester has the same field. The text
consists of settings such as ``Timeout=300``, separated by commas. bcapscope sends most settings to the
controller: ``WDT`` and ``InvokeTimeout`` with Service_Start, and settings such as ``Server`` with
Controller_Connect. The settings ``Timeout``, ``Retry`` and ``Reserved`` only define how bcapscope makes
calls.
"""

from __future__ import annotations

from dataclasses import replace

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.protocol.retry.reserved_convention import ReservedConvention, client_conventions
from bcapscope.tui.reader_language import label

_SERVICE_KEYS = ("wdt", "invoketimeout")

AUTOMATIC_PROVIDERS = ("CaoProv.DENSO.VRC", "CaoProv.DENSO.VRC9", "")
"""Names of providers. If the user names no provider, bcapscope tries these names in this order. The first
provider is for RC8 and COBOTTA, the second for RC9 and COBOTTA PRO. An RC7 ignores the provider's name.
"""


def read_option_field(text: str, host: str, port: int, tcp: bool) -> tuple[ControllerTarget, tuple[str, ...]]:
    """Parse the Option field. Return the controller to connect to, and the names of the providers to try.

    Raises:
        ValueError: A setting is invalid. The error text quotes the setting, and says what is expected.
    """
    target = ControllerTarget(host, port, tcp, name="")
    providers: tuple[str, ...] = AUTOMATIC_PROVIDERS
    for part in filter(None, (each.strip() for each in text.split(","))):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        folded = key.casefold()
        if key.startswith("@") or folded in ("interval", "server"):
            target = replace(target, connect_option=",".join(filter(None, (target.connect_option, part))))
        elif not equals:
            raise ValueError(label("controller.option.pair", part=part, help=label("controller.option.help")))
        elif folded in _SERVICE_KEYS:
            _bounded_integer(key, value, 80, 10_000_000)
            target = replace(target, service=f"{target.service},{key}={value}")
        elif folded == "provider":
            providers = (value,)
        else:
            target = _with_own_key(target, key, value)
    return replace(target, provider=providers[0]), providers


def _with_own_key(target: ControllerTarget, key: str, value: str) -> ControllerTarget:
    folded = key.casefold()
    if folded == "timeout":
        return replace(target, timeout=float(_bounded_integer(key, value, 1, 600_000)))
    if folded in ("retry", "retries"):
        return replace(target, retries=_bounded_integer(key, value, 0, 100))
    if folded == "machine":
        return replace(target, machine=value)
    if folded == "name":
        return replace(target, name=value)
    if folded == "reserved":
        return replace(target, convention=_convention(value, target.tcp))
    raise ValueError(label("controller.option.unknown", key=key, help=label("controller.option.help")))


def _bounded_integer(key: str, value: str, low: int, high: int) -> int:
    number = int(value) if value.isascii() and value.isdecimal() and len(value) < 12 else -1
    if not low <= number <= high:
        raise ValueError(label("controller.option.whole", key=key, value=value, low=low, high=high))
    return number


def _convention(value: str, tcp: bool) -> ReservedConvention:
    allowed = [each.value for each in client_conventions(not tcp)]
    if value.casefold() not in allowed:
        raise ValueError(label("controller.option.reserved", value=value, allowed=", ".join(allowed)))
    return ReservedConvention(value.casefold())
