"""The 137 functions of b-CAP: ids, arguments, results, and the handles that they create or release.

All of DENSO's client libraries use the same ids and the same order of arguments (orin_bcap
C/include/bcap_funcid.h and the C#, Java and Python clients). The names and types of the arguments come from
the C client's prototypes (orin_bcap C/src/bCAPClient/bcap_client.c). orin_bcap
C/include/bCAPServer/bcap_mapid.h shows which functions create and release handles.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import NamedTuple

from bcapscope.protocol.tables.table_rows import table_rows


class ObjectClass(StrEnum):
    """Class of the object that a handle refers to. Every function belongs to one class."""

    SERVICE = "Service"
    CONTROLLER = "Controller"
    EXTENSION = "Extension"
    FILE = "File"
    ROBOT = "Robot"
    TASK = "Task"
    VARIABLE = "Variable"
    COMMAND = "Command"
    MESSAGE = "Message"


class ResultKind(StrEnum):
    """Type of the value in a successful reply; `NONE` if the reply has no value."""

    NONE = "none"
    HANDLE = "handle"
    """A handle (VT_I4), valid until the client releases the object."""
    I4 = "I4"
    BSTR = "BSTR"
    VARIANT = "VARIANT"
    """A VARIANT; its type depends on the command or the variable."""
    NAMES = "names"
    """A VARIANT with an array of names."""
    DATE = "DATE"
    """A VARIANT with a VT_DATE."""


class Param(NamedTuple):
    """The vendor's name of an argument, such as `hRobot`, and its type; `VARIANT` if any type is allowed."""

    name: str
    type: str


@dataclass(frozen=True, slots=True)
class Function:
    """One function of the protocol.

    Attributes:
        id: Function id, 1..137, at offset 9 of a request.
        owner: Class of the object to which the handle in the first argument must refer.
        params: Arguments, the handle first. Clients always send optional strings, if necessary as an empty
            string.
        result_name: The vendor's name of the result, such as `hRobot` or `pVal`.
        creates: Class of the object that a successful call opens. Service_Start's object has no handle.
        note: One clause that says how implementations of the function disagree; empty if they agree.
    """

    id: int
    name: str
    owner: ObjectClass
    params: tuple[Param, ...]
    result: ResultKind
    result_name: str | None
    creates: ObjectClass | None
    releases: ObjectClass | None
    note: str

    @property
    def takes_handle(self) -> bool:
        """Whether the first argument is a handle. Other arguments are never handles."""
        return bool(self.params) and self.params[0].name.startswith("h")


# The prefix of DENSO's name for an argument shows its type, as in `lAxis` or `bstrCommand`.
# The argument newVal has no prefix: its type is VT_I4 in function 115, and any type elsewhere.
_TYPE_BY_PREFIX = (("bstr", "VT_BSTR"), ("vnt", "VARIANT"), ("h", "VT_I4"), ("l", "VT_I4"), ("f", "VT_R4"))


def _param(function_id: int, name: str) -> Param:
    if name == "newVal":
        return Param(name, "VT_I4" if function_id == 115 else "VARIANT")
    return Param(name, next(type_ for prefix, type_ in _TYPE_BY_PREFIX if name.startswith(prefix)))


def _created_class(name: str, result: ResultKind) -> ObjectClass | None:
    """Return the class of the object that a function creates: `Robot_GetVariable` creates a variable."""
    if name in ("Service_Start", "Controller_Connect"):
        return ObjectClass(name.partition("_")[0])
    return ObjectClass(name.partition("_Get")[2]) if result is ResultKind.HANDLE else None


def _function(row: dict[str, str]) -> Function:
    id_, name, result = int(row["id"]), row["name"], ResultKind(row["result"])
    owner, _, verb = name.partition("_")
    creates = _created_class(name, result)
    releases = verb == "Release" or name in ("Service_Stop", "Controller_Disconnect")
    handle_name = f"h{creates}" if result is ResultKind.HANDLE else "pVal"
    return Function(
        id=id_,
        name=name,
        owner=ObjectClass(owner),
        params=tuple(_param(id_, param) for param in row["arguments"].split()),
        result=result,
        result_name=None if result is ResultKind.NONE else handle_name,
        creates=creates,
        releases=ObjectClass(owner) if releases else None,
        note=row["note"],
    )


_ALL = [_function(row) for row in table_rows("functions")]

FUNCTIONS: Mapping[int, Function] = MappingProxyType({function.id: function for function in _ALL})

ID: Mapping[str, int] = MappingProxyType({function.name: function.id for function in _ALL})

_BY_NAME = {function.name.casefold(): function for function in _ALL}
_NAME_BY_ID = {function.id: function.name for function in _ALL}


def signed_function_id(code: int) -> int:
    """Convert the unsigned code of a request to the function id, a signed 32-bit integer."""
    return code - 0x1_0000_0000 if 0x8000_0000 <= code <= 0xFFFF_FFFF else code


def function_name(function_id: int) -> str:
    """Return the name of a function, such as `Robot_Execute`; `Unknown(200)` for an id outside 1..137."""
    return _NAME_BY_ID.get(function_id) or f"Unknown({signed_function_id(function_id)})"


def function_by_name(name: str) -> Function | None:
    """Return the function with this name, ignoring case; None if unknown."""
    return _BY_NAME.get(name.casefold())


_ANY = "VARIANT"
_RESULT_TYPES = {ResultKind.HANDLE: "VT_I4", ResultKind.I4: "VT_I4", ResultKind.BSTR: "VT_BSTR"}


def request_param(function_id: int | None, index: int) -> Param:
    """Return the name and type of the argument at `index`, from 0. Index 3 without a name is `arg4`."""
    function = FUNCTIONS.get(function_id) if function_id is not None else None
    if function is not None and index < len(function.params):
        return function.params[index]
    return Param(f"arg{index + 1}", _ANY)


def result_param(function_id: int | None, index: int) -> Param:
    """Return the name and type of the value at `index`, from 0, in a function's reply."""
    function = FUNCTIONS.get(function_id) if function_id is not None else None
    if index:
        return Param(f"arg{index + 1}", _ANY)
    if function is None or function.result_name is None:
        return Param("pVal", _ANY)
    return Param(function.result_name, _RESULT_TYPES.get(function.result, _ANY))
