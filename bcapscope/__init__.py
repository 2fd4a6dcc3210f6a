"""bcapscope: see, test and simulate b-CAP, the Ethernet protocol of DENSO robot controllers.

The names below load their modules when they are first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bcapscope.client.controller_connection import connect_controller as connect
    from bcapscope.testing.embedded_proxy import EmbeddedProxy as Proxy
    from bcapscope.testing.embedded_simulator import EmbeddedSimulator as Simulator

__version__ = "0.1.0"

__all__ = ["Proxy", "Simulator", "connect"]

_NAMES = {
    "Proxy": "bcapscope.testing.embedded_proxy:EmbeddedProxy",
    "Simulator": "bcapscope.testing.embedded_simulator:EmbeddedSimulator",
    "connect": "bcapscope.client.controller_connection:connect_controller",
}
"""Module and object of each public name."""


def __getattr__(name: str) -> object:
    if name not in _NAMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module  # noqa: PLC0415 - `bcapscope --help` loads this

    module, _, attribute = _NAMES[name].partition(":")
    found: object = getattr(import_module(module), attribute)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *_NAMES})
