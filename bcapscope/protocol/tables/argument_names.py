"""Names and types of the arguments of requests and replies."""

from __future__ import annotations

from bcapscope.protocol.tables.function_table import FUNCTIONS, Param, ResultKind

_ANY = "VARIANT"
_RESULT_TYPES = {ResultKind.HANDLE: "VT_I4", ResultKind.I4: "VT_I4", ResultKind.BSTR: "VT_BSTR"}


def request_param(function_id: int | None, index: int) -> Param:
    """Return the name and type of a request's argument, by its index from 0.

    A surplus argument is named by its number from 1, such as `arg4`.
    """
    function = FUNCTIONS.get(function_id) if function_id is not None else None
    if function is not None and index < len(function.params):
        return function.params[index]
    return Param(f"arg{index + 1}", _ANY)


def result_param(function_id: int | None, index: int) -> Param:
    """Return the name and type of an argument in the reply to a function, by its index from 0."""
    function = FUNCTIONS.get(function_id) if function_id is not None else None
    if index:
        return Param(f"arg{index + 1}", _ANY)
    if function is None or function.result_name is None:
        return Param("pVal", _ANY)
    return Param(function.result_name, _RESULT_TYPES.get(function.result, _ANY))
