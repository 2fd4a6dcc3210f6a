"""The 137 functions of b-CAP: ids, arguments, results, and the handles that they create or release.

Ids and the order of arguments are the same in all of DENSO's client libraries (orin_bcap
C/include/bcap_funcid.h and the C#, Java and Python clients). Argument names and types are those of the C
client's prototypes (orin_bcap C/src/bCAPClient/bcap_client.c). The functions that create and release handles
are those of orin_bcap C/include/bCAPServer/bcap_mapid.h.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import NamedTuple


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
    """Kind of result that a successful reply carries in its only argument."""

    NONE = "none"
    HANDLE = "handle"
    """A handle (VT_I4), valid until the client releases the object."""
    I4 = "I4"
    BSTR = "BSTR"
    VARIANT = "VARIANT"
    """A VARIANT whose type depends on the command or the variable."""
    NAMES = "names"
    """A VARIANT with an array of names."""
    DATE = "DATE"
    """A VARIANT with a VT_DATE."""


class Param(NamedTuple):
    """Name and type of an argument of a request.

    Attributes:
        name: The vendor's name of the argument, such as `hRobot` or `bstrCommand`.
        type: `VT_I4`, `VT_R4` or `VT_BSTR`; `VARIANT` if any type is allowed.
    """

    name: str
    type: str


@dataclass(frozen=True, slots=True)
class Function:
    """One function of the protocol.

    Attributes:
        id: Function id, 1..137, at offset 9 of a request.
        name: The vendor's name of the function: class, underscore and verb, such as `Robot_Execute`.
        owner: Class of the object that the first argument's handle must stand for.
        params: Arguments of the request in order, the handle first. Clients always send optional strings, if
            need be empty.
        result: Kind of result in a successful reply.
        result_name: The vendor's name of the result, such as `hRobot` or `pVal`; None if there is no result.
        creates: Class of the object that a successful call opens; None if it opens no object. The object that
            Service_Start opens has no handle.
        releases: Class of the object that a successful call releases; None if it releases no object.
        note: How implementations of the function disagree, one clause; empty if they agree.
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
        """Whether the first argument is a handle; all other arguments are never handles."""
        return bool(self.params) and self.params[0].name.startswith("h")


_NONE, _HANDLE, _I4, _BSTR = ResultKind.NONE, ResultKind.HANDLE, ResultKind.I4, ResultKind.BSTR
_VARIANT, _NAMES, _DATE = ResultKind.VARIANT, ResultKind.NAMES, ResultKind.DATE

_FUNCTION_ROWS: tuple[tuple[int, str, str, ResultKind], ...] = (
    (1, "Service_Start", "bstrOption", _NONE),
    (2, "Service_Stop", "", _NONE),
    (3, "Controller_Connect", "bstrName bstrProvider bstrMachine bstrOption", _HANDLE),
    (4, "Controller_Disconnect", "hController", _NONE),
    (5, "Controller_GetExtension", "hController bstrName bstrOption", _HANDLE),
    (6, "Controller_GetFile", "hController bstrName bstrOption", _HANDLE),
    (7, "Controller_GetRobot", "hController bstrName bstrOption", _HANDLE),
    (8, "Controller_GetTask", "hController bstrName bstrOption", _HANDLE),
    (9, "Controller_GetVariable", "hController bstrName bstrOption", _HANDLE),
    (10, "Controller_GetCommand", "hController bstrName bstrOption", _HANDLE),
    (11, "Controller_GetExtensionNames", "hController bstrOption", _NAMES),
    (12, "Controller_GetFileNames", "hController bstrOption", _NAMES),
    (13, "Controller_GetRobotNames", "hController bstrOption", _NAMES),
    (14, "Controller_GetTaskNames", "hController bstrOption", _NAMES),
    (15, "Controller_GetVariableNames", "hController bstrOption", _NAMES),
    (16, "Controller_GetCommandNames", "hController bstrOption", _NAMES),
    (17, "Controller_Execute", "hController bstrCommand vntParam", _VARIANT),
    (18, "Controller_GetMessage", "hController", _HANDLE),
    (19, "Controller_GetAttribute", "hController", _I4),
    (20, "Controller_GetHelp", "hController", _BSTR),
    (21, "Controller_GetName", "hController", _BSTR),
    (22, "Controller_GetTag", "hController", _VARIANT),
    (23, "Controller_PutTag", "hController newVal", _NONE),
    (24, "Controller_GetID", "hController", _VARIANT),
    (25, "Controller_PutID", "hController newVal", _NONE),
    (26, "Extension_GetVariable", "hExtension bstrName bstrOption", _HANDLE),
    (27, "Extension_GetVariableNames", "hExtension bstrOption", _NAMES),
    (28, "Extension_Execute", "hExtension bstrCommand vntParam", _VARIANT),
    (29, "Extension_GetAttribute", "hExtension", _I4),
    (30, "Extension_GetHelp", "hExtension", _BSTR),
    (31, "Extension_GetName", "hExtension", _BSTR),
    (32, "Extension_GetTag", "hExtension", _VARIANT),
    (33, "Extension_PutTag", "hExtension newVal", _NONE),
    (34, "Extension_GetID", "hExtension", _VARIANT),
    (35, "Extension_PutID", "hExtension newVal", _NONE),
    (36, "Extension_Release", "hExtension", _NONE),
    (37, "File_GetFile", "hFile bstrName bstrOption", _HANDLE),
    (38, "File_GetVariable", "hFile bstrName bstrOption", _HANDLE),
    (39, "File_GetFileNames", "hFile bstrOption", _NAMES),
    (40, "File_GetVariableNames", "hFile bstrOption", _NAMES),
    (41, "File_Execute", "hFile bstrCommand vntParam", _VARIANT),
    (42, "File_Copy", "hFile bstrName bstrOption", _NONE),
    (43, "File_Delete", "hFile bstrOption", _NONE),
    (44, "File_Move", "hFile bstrName bstrOption", _NONE),
    (45, "File_Run", "hFile bstrOption", _BSTR),
    (46, "File_GetDateCreated", "hFile", _DATE),
    (47, "File_GetDateLastAccessed", "hFile", _DATE),
    (48, "File_GetDateLastModified", "hFile", _DATE),
    (49, "File_GetPath", "hFile", _BSTR),
    (50, "File_GetSize", "hFile", _I4),
    (51, "File_GetType", "hFile", _BSTR),
    (52, "File_GetValue", "hFile", _VARIANT),
    (53, "File_PutValue", "hFile newVal", _NONE),
    (54, "File_GetAttribute", "hFile", _I4),
    (55, "File_GetHelp", "hFile", _BSTR),
    (56, "File_GetName", "hFile", _BSTR),
    (57, "File_GetTag", "hFile", _VARIANT),
    (58, "File_PutTag", "hFile newVal", _NONE),
    (59, "File_GetID", "hFile", _VARIANT),
    (60, "File_PutID", "hFile newVal", _NONE),
    (61, "File_Release", "hFile", _NONE),
    (62, "Robot_GetVariable", "hRobot bstrName bstrOption", _HANDLE),
    (63, "Robot_GetVariableNames", "hRobot bstrOption", _NAMES),
    (64, "Robot_Execute", "hRobot bstrCommand vntParam", _VARIANT),
    (65, "Robot_Accelerate", "hRobot lAxis fAccel fDecel", _NONE),
    (66, "Robot_Change", "hRobot bstrName", _NONE),
    (67, "Robot_Chuck", "hRobot bstrOption", _NONE),
    (68, "Robot_Drive", "hRobot lNo fMov bstrOption", _NONE),
    (69, "Robot_GoHome", "hRobot", _NONE),
    (70, "Robot_Halt", "hRobot bstrOption", _NONE),
    (71, "Robot_Hold", "hRobot bstrOption", _NONE),
    (72, "Robot_Move", "hRobot lComp vntPose bstrOption", _NONE),
    (73, "Robot_Rotate", "hRobot vntRotSuf fDeg vntPivot bstrOption", _NONE),
    (74, "Robot_Speed", "hRobot lAxis fSpeed", _NONE),
    (75, "Robot_Unchuck", "hRobot bstrOption", _NONE),
    (76, "Robot_Unhold", "hRobot bstrOption", _NONE),
    (77, "Robot_GetAttribute", "hRobot", _I4),
    (78, "Robot_GetHelp", "hRobot", _BSTR),
    (79, "Robot_GetName", "hRobot", _BSTR),
    (80, "Robot_GetTag", "hRobot", _VARIANT),
    (81, "Robot_PutTag", "hRobot newVal", _NONE),
    (82, "Robot_GetID", "hRobot", _VARIANT),
    (83, "Robot_PutID", "hRobot newVal", _NONE),
    (84, "Robot_Release", "hRobot", _NONE),
    (85, "Task_GetVariable", "hTask bstrName bstrOption", _HANDLE),
    (86, "Task_GetVariableNames", "hTask bstrOption", _NAMES),
    (87, "Task_Execute", "hTask bstrCommand vntParam", _VARIANT),
    (88, "Task_Start", "hTask lMode bstrOption", _NONE),
    (89, "Task_Stop", "hTask lMode bstrOption", _NONE),
    (90, "Task_Delete", "hTask bstrOption", _NONE),
    (91, "Task_GetFileName", "hTask", _BSTR),
    (92, "Task_GetAttribute", "hTask", _I4),
    (93, "Task_GetHelp", "hTask", _BSTR),
    (94, "Task_GetName", "hTask", _BSTR),
    (95, "Task_GetTag", "hTask", _VARIANT),
    (96, "Task_PutTag", "hTask newVal", _NONE),
    (97, "Task_GetID", "hTask", _VARIANT),
    (98, "Task_PutID", "hTask newVal", _NONE),
    (99, "Task_Release", "hTask", _NONE),
    (100, "Variable_GetDateTime", "hVariable", _DATE),
    (101, "Variable_GetValue", "hVariable", _VARIANT),
    (102, "Variable_PutValue", "hVariable newVal", _NONE),
    (103, "Variable_GetAttribute", "hVariable", _I4),
    (104, "Variable_GetHelp", "hVariable", _BSTR),
    (105, "Variable_GetName", "hVariable", _BSTR),
    (106, "Variable_GetTag", "hVariable", _VARIANT),
    (107, "Variable_PutTag", "hVariable newVal", _NONE),
    (108, "Variable_GetID", "hVariable", _VARIANT),
    (109, "Variable_PutID", "hVariable newVal", _NONE),
    (110, "Variable_GetMicrosecond", "hVariable", _I4),
    (111, "Variable_Release", "hVariable", _NONE),
    (112, "Command_Execute", "hCommand lMode", _VARIANT),
    (113, "Command_Cancel", "hCommand", _NONE),
    (114, "Command_GetTimeout", "hCommand", _I4),
    (115, "Command_PutTimeout", "hCommand newVal", _NONE),
    (116, "Command_GetState", "hCommand", _I4),
    (117, "Command_GetParameters", "hCommand", _VARIANT),
    (118, "Command_PutParameters", "hCommand newVal", _NONE),
    (119, "Command_GetResult", "hCommand", _VARIANT),
    (120, "Command_GetAttribute", "hCommand", _I4),
    (121, "Command_GetHelp", "hCommand", _BSTR),
    (122, "Command_GetName", "hCommand", _BSTR),
    (123, "Command_GetTag", "hCommand", _VARIANT),
    (124, "Command_PutTag", "hCommand newVal", _NONE),
    (125, "Command_GetID", "hCommand", _VARIANT),
    (126, "Command_PutID", "hCommand newVal", _NONE),
    (127, "Command_Release", "hCommand", _NONE),
    (128, "Message_Reply", "hMessage vntData", _NONE),
    (129, "Message_Clear", "hMessage", _NONE),
    (130, "Message_GetDateTime", "hMessage", _DATE),
    (131, "Message_GetDescription", "hMessage", _BSTR),
    (132, "Message_GetDestination", "hMessage", _BSTR),
    (133, "Message_GetNumber", "hMessage", _I4),
    (134, "Message_GetSerialNumber", "hMessage", _I4),
    (135, "Message_GetSource", "hMessage", _BSTR),
    (136, "Message_GetValue", "hMessage", _VARIANT),
    (137, "Message_Release", "hMessage", _NONE),
)

_NOTES = {
    112: "the C server's table says that nothing comes back, the C client waits for a VARIANT, the Python "
    "client takes nothing",
    124: "the C server's table says that a value comes back, no client takes one",
}

# The prefix of the vendor's argument names gives the type. The name newVal has no prefix: its type is VT_I4
# in function 115, otherwise any type.
_TYPE_BY_PREFIX = (("bstr", "VT_BSTR"), ("vnt", "VARIANT"), ("h", "VT_I4"), ("l", "VT_I4"), ("f", "VT_R4"))


def _param(function_id: int, name: str) -> Param:
    if name == "newVal":
        return Param(name, "VT_I4" if function_id == 115 else "VARIANT")
    return Param(name, next(type_ for prefix, type_ in _TYPE_BY_PREFIX if name.startswith(prefix)))


def _created_class(name: str, result: ResultKind) -> ObjectClass | None:
    """Return the class of the object that a function creates: `Robot_GetVariable` creates a variable."""
    if name in ("Service_Start", "Controller_Connect"):
        return ObjectClass(name.partition("_")[0])
    return ObjectClass(name.partition("_Get")[2]) if result is _HANDLE else None


def _function(id_: int, name: str, params: str, result: ResultKind) -> Function:
    owner, _, verb = name.partition("_")
    creates = _created_class(name, result)
    releases = verb == "Release" or name in ("Service_Stop", "Controller_Disconnect")
    handle_name = f"h{creates}" if result is _HANDLE else "pVal"
    return Function(
        id=id_,
        name=name,
        owner=ObjectClass(owner),
        params=tuple(_param(id_, param) for param in params.split()),
        result=result,
        result_name=None if result is _NONE else handle_name,
        creates=creates,
        releases=ObjectClass(owner) if releases else None,
        note=_NOTES.get(id_, ""),
    )


FUNCTIONS: Mapping[int, Function] = MappingProxyType({row[0]: _function(*row) for row in _FUNCTION_ROWS})
"""All functions of b-CAP by function id, in the order of the ids."""

ID: Mapping[str, int] = MappingProxyType({function.name: function.id for function in FUNCTIONS.values()})
"""Function ids by function name."""

_BY_NAME = {function.name.casefold(): function for function in FUNCTIONS.values()}
_NAME_BY_ID = {function.id: function.name for function in FUNCTIONS.values()}


def signed_function_id(code: int) -> int:
    """Return the code of a request as a function id. On the wire, function ids are signed 32-bit integers."""
    return code - 0x1_0000_0000 if 0x8000_0000 <= code <= 0xFFFF_FFFF else code


def function_name(function_id: int) -> str:
    """Return the name of a function, such as `Robot_Execute`; `Unknown(200)` for an id outside 1..137."""
    return _NAME_BY_ID.get(function_id) or f"Unknown({signed_function_id(function_id)})"


def function_by_name(name: str) -> Function | None:
    """Return the function with this name, ignoring case; None if unknown."""
    return _BY_NAME.get(name.casefold())
