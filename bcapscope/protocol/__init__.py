"""The b-CAP protocol: frames, VARIANTs, functions, commands and result codes.

The package uses only the standard library. The package does no I/O and reads no clock. Other programs can
import the names in `__all__` directly from `bcapscope.protocol`. Each name is loaded on first use, so that an
import of one submodule does not load the other submodules.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bcapscope.protocol.codec.frame import Frame as Frame
    from bcapscope.protocol.codec.frame import Malformed as Malformed
    from bcapscope.protocol.codec.frame import encode_frame as encode_frame
    from bcapscope.protocol.codec.frame import parse_datagram as parse_datagram
    from bcapscope.protocol.codec.frame import parse_single_frame as parse_single_frame
    from bcapscope.protocol.codec.stream_splitter import StreamPiece as StreamPiece
    from bcapscope.protocol.codec.stream_splitter import StreamSplitter as StreamSplitter
    from bcapscope.protocol.codec.variant import ARRAY as ARRAY
    from bcapscope.protocol.codec.variant import EMPTY as EMPTY
    from bcapscope.protocol.codec.variant import VT as VT
    from bcapscope.protocol.codec.variant import Variant as Variant
    from bcapscope.protocol.codec.variant import integer_value as integer_value
    from bcapscope.protocol.codec.variant import vt_name as vt_name
    from bcapscope.protocol.tables.command_catalogue import call_name as call_name
    from bcapscope.protocol.tables.function_table import FUNCTIONS as FUNCTIONS
    from bcapscope.protocol.tables.function_table import Function as Function
    from bcapscope.protocol.tables.function_table import function_by_name as function_by_name
    from bcapscope.protocol.tables.function_table import function_name as function_name
    from bcapscope.protocol.tables.hresult import HresultInfo as HresultInfo
    from bcapscope.protocol.tables.hresult import describe_hresult as describe_hresult
    from bcapscope.protocol.tables.hresult import hresult_name as hresult_name
    from bcapscope.protocol.tables.hresult import is_failure as is_failure
    from bcapscope.protocol.tables.hresult import is_success as is_success

_NAMES_BY_MODULE = {
    "codec.frame": "Frame Malformed encode_frame parse_datagram parse_single_frame",
    "codec.stream_splitter": "StreamPiece StreamSplitter",
    "codec.variant": "ARRAY EMPTY VT Variant integer_value vt_name",
    "tables.command_catalogue": "call_name",
    "tables.function_table": "FUNCTIONS Function function_by_name function_name",
    "tables.hresult": "HresultInfo describe_hresult hresult_name is_failure is_success",
}
_MODULE_BY_NAME = {name: module for module, names in _NAMES_BY_MODULE.items() for name in names.split()}
__all__ = list(_MODULE_BY_NAME)


# Hide `__getattr__` from type checkers, which would otherwise accept any name in the module.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """Import the submodule that defines `name`, and return the object with this name."""
        module = _MODULE_BY_NAME.get(name)
        if module is None:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module  # noqa: PLC0415 - seldom needed

        value = getattr(import_module(f"{__name__}.{module}"), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
