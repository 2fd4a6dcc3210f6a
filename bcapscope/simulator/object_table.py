"""The objects that a client has opened, by handle."""

from __future__ import annotations

from dataclasses import dataclass, field

from bcapscope.errors import LocalProtocolError
from bcapscope.protocol.codec.variant import VT, Variant, encode_variant
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.protocol.tables.hresult import E_HANDLE, E_MAX_OBJECT
from bcapscope.simulator.call_outcome import RefusalCode, RefusedError

MAX_OBJECTS = 1000
LONGEST_NAME = 255
LARGEST_VALUE = 4096
"""Maximum size in bytes of a tag or an ID that a client stores; the limit is bcapscope's own."""

_HANDLE_TYPES = (VT.I4, VT.UI4, VT.I2)  # VARIANT types that the C server accepts


@dataclass(slots=True)
class ControllerObject:
    """One object of a client, opened from its `parent`; a controller has no parent.

    `values` contains the values that the object holds, such as a command's parameters. "tag" and "id" are the
    values that the client stored with PutTag and PutID. If a variable's name ends in `*`, the id is the
    number of the variable.
    """

    handle: int
    kind: ObjectClass
    name: str
    parent: ControllerObject | None
    values: dict[str, Variant] = field(default_factory=dict)


class ObjectTable(dict[int, ControllerObject]):
    """The open objects of one client, by handle. A handle is never used again."""

    _next = 1

    def open(self, kind: ObjectClass, name: str, parent: ControllerObject | None) -> ControllerObject:
        if len(self) >= MAX_OBJECTS:
            raise RefusedError(E_MAX_OBJECT)
        if len(name) > LONGEST_NAME:
            raise RefusedError(RefusalCode.OUT_OF_MEMORY)
        made = ControllerObject(self._next, kind, name, parent)
        self._next = self._next % 0x7FFFFFFF + 1
        self[made.handle] = made
        return made

    def open_named(
        self, kind: ObjectClass, name: str, parent: ControllerObject | None, option: str
    ) -> ControllerObject:
        found = self.find_by_name(kind, name, parent) if "@ifnotmember" in option.casefold() else None
        return self.open(kind, name, parent) if found is None else found

    def find(self, kind: ObjectClass, handle: Variant) -> ControllerObject:
        value = handle.value
        found = self.get(value) if handle.vt in _HANDLE_TYPES and isinstance(value, int) else None
        if found is None or found.kind is not kind:
            raise RefusedError(E_HANDLE)
        return found

    def find_by_name(
        self, kind: ObjectClass, name: str, parent: ControllerObject | None
    ) -> ControllerObject | None:
        folded = name.casefold()
        for each in self.values():
            if each.kind is kind and each.parent is parent and each.name.casefold() == folded:
                return each
        return None

    def release(self, target: ControllerObject) -> None:
        handles = [handle for handle, each in self.items() if _belongs_to(each, target)]
        for handle in handles:
            del self[handle]


def _belongs_to(each: ControllerObject | None, owner: ControllerObject) -> bool:
    while each is not None and each is not owner:
        each = each.parent
    return each is owner


def check_storable(value: Variant) -> Variant:
    """Return a value to store; refuse a value that is too large or of a type that cannot be sent back."""
    try:
        size = len(encode_variant(value))
    except LocalProtocolError:
        raise RefusedError(RefusalCode.TYPE_MISMATCH) from None
    if size > LARGEST_VALUE:
        raise RefusedError(RefusalCode.OUT_OF_MEMORY)
    return value
