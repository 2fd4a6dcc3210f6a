"""bcapscope decodes, tests and simulates b-CAP, the Ethernet protocol of DENSO robot controllers.

docs/python.md describes the names of this module. Each name is loaded on first use, so that
``import bcapscope`` is fast. CHANGELOG.md says how these names may change.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bcapscope.analysis.finding import Finding as Finding
    from bcapscope.analysis.slave.slave_session import SlaveSession as SlaveSession
    from bcapscope.api.data_tables import Records as Records
    from bcapscope.api.data_tables import TableRecords as TableRecords
    from bcapscope.api.opened_capture import Capture as Capture
    from bcapscope.api.opened_capture import open as open
    from bcapscope.api.reported_finding import ReportedFinding as ReportedFinding
    from bcapscope.api.single_frame import decode as decode
    from bcapscope.api.single_frame import encode as encode
    from bcapscope.client.controller_connection import connect_controller
    from bcapscope.errors import BcapError as BcapError
    from bcapscope.errors import CallTimeout as CallTimeout
    from bcapscope.errors import CaptureError as CaptureError
    from bcapscope.errors import ControllerError as ControllerError
    from bcapscope.errors import FileWriteError as FileWriteError
    from bcapscope.errors import InputError as InputError
    from bcapscope.errors import LocalProtocolError as LocalProtocolError
    from bcapscope.errors import MissingExtraError as MissingExtraError
    from bcapscope.errors import RemoteProtocolError as RemoteProtocolError
    from bcapscope.errors import TooLargeError as TooLargeError
    from bcapscope.protocol.codec.arguments import Argument as Argument
    from bcapscope.protocol.codec.arguments import Problem as Problem
    from bcapscope.protocol.codec.frame import Frame as Frame
    from bcapscope.protocol.codec.variant import VT as VT
    from bcapscope.protocol.codec.variant import Variant as Variant
    from bcapscope.testing.embedded_proxy import EmbeddedProxy
    from bcapscope.testing.embedded_simulator import EmbeddedSimulator
    from bcapscope.traffic.call import Call as Call
    from bcapscope.traffic.filter.compiler import FilterError as FilterError
    from bcapscope.traffic.filter.getters import AnnotatedFrame as AnnotatedFrame

    Proxy = EmbeddedProxy
    Simulator = EmbeddedSimulator
    connect = connect_controller

__version__ = "0.1.0"

_NAMES_BY_MODULE = {
    "analysis.finding": "Finding",
    "analysis.slave.slave_session": "SlaveSession",
    "api.data_tables": "Records TableRecords",
    "api.opened_capture": "Capture open",
    "api.reported_finding": "ReportedFinding",
    "api.single_frame": "decode encode",
    "client.controller_connection": "connect=connect_controller",
    "errors": "BcapError CallTimeout CaptureError ControllerError FileWriteError InputError "
    "LocalProtocolError MissingExtraError RemoteProtocolError TooLargeError",
    "protocol.codec.arguments": "Argument Problem",
    "protocol.codec.frame": "Frame",
    "protocol.codec.variant": "VT Variant",
    "testing.embedded_proxy": "Proxy=EmbeddedProxy",
    "testing.embedded_simulator": "Simulator=EmbeddedSimulator",
    "traffic.call": "Call",
    "traffic.filter.compiler": "FilterError",
    "traffic.filter.getters": "AnnotatedFrame",
}
"""For each module, the public names that it defines. ``Proxy=EmbeddedProxy`` means that `EmbeddedProxy` has
the public name `Proxy`.
"""

_OBJECTS = {
    name: (module, attribute or name)
    for module, names in _NAMES_BY_MODULE.items()
    for name, _, attribute in (each.partition("=") for each in names.split())
}
__all__ = list(_OBJECTS)  # to add a public name, add an import above and an entry in _NAMES_BY_MODULE


if not TYPE_CHECKING:  # type checkers must not see `__getattr__`, because they would then accept every name

    def __getattr__(name: str) -> object:
        """Import the module that defines a public name, and return the object that has this name."""
        if name not in _OBJECTS:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module  # noqa: PLC0415 - most uses of bcapscope do not need importlib

        module, attribute = _OBJECTS[name]
        value = getattr(import_module(f"{__name__}.{module}"), attribute)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
