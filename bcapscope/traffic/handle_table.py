"""Table of the objects that a client has open in the controller, by handle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.tables.function_table import Function, ObjectClass

_ROOTS = (ObjectClass.SERVICE, ObjectClass.CONTROLLER)


class ObjectHandle(NamedTuple):
    """An object in the controller for which the client holds a handle.

    Attributes:
        kind: Class of the object.
        handle: Number that the controller gave.
        opened_with: String arguments of the opening call, such as name and option. For a controller, the
            four strings of Controller_Connect.
        parent: Object through which the client opened this one; None for a controller.
    """

    kind: ObjectClass
    handle: int
    opened_with: tuple[str, ...]
    parent: ObjectHandle | None

    @property
    def label(self) -> str:
        """Display name: the first string of `opened_with`, or class and number, such as `Message 3`."""
        return (self.opened_with[0] if self.opened_with else "") or f"{self.kind} {self.handle}"


class HandleTable:
    """Tracks the open objects of one session from its successful calls."""

    def __init__(self) -> None:
        self._open: dict[tuple[ObjectClass, int], ObjectHandle] = {}

    def record_call(
        self, function: Function, arguments: Sequence[Variant], reply: Frame
    ) -> ObjectHandle | None:
        """Record a successful call; return the object that it opened, or None."""
        target = self.find(function.owner, _number(arguments[0]) if arguments else None)
        if function.creates is not None and function.creates is not ObjectClass.SERVICE:
            return self._add(function.creates, arguments, target, reply)
        if function.releases is ObjectClass.SERVICE:
            self._open.clear()
        elif target is not None and function.releases is not None:
            self._remove(target)
        return None

    def find(self, kind: ObjectClass, handle: int | None) -> ObjectHandle | None:
        """Return the object of a handle, or None if the table does not know it."""
        return None if handle is None else self._open.get((kind, handle))

    def open_handles(self, kind: ObjectClass | None = None) -> tuple[ObjectHandle, ...]:
        """List the open objects of one class, or of all classes, in opening order."""
        return tuple(one for one in self._open.values() if kind is None or one.kind is kind)

    def _add(
        self, kind: ObjectClass, arguments: Sequence[Variant], parent: ObjectHandle | None, reply: Frame
    ) -> ObjectHandle | None:
        handle = _number(reply.arguments[0].variant) if reply.arguments else None
        if handle is None:
            return None
        asked = tuple(str(each.value) for each in arguments if isinstance(each.value, str))
        opened = ObjectHandle(kind, handle, asked, parent)
        self._open.pop((kind, handle), None)
        self._open[kind, handle] = opened
        return opened

    def _remove(self, released: ObjectHandle) -> None:
        """Remove an object. Removing a controller also removes every object opened through it."""
        self._open.pop((released.kind, released.handle), None)
        if released.kind in _ROOTS:
            self._open = {key: one for key, one in self._open.items() if not _is_below(one, released)}


def _is_below(handle: ObjectHandle, ancestor: ObjectHandle) -> bool:
    above = handle.parent
    while above is not None and above != ancestor:
        above = above.parent
    return above is not None


def _number(variant: Variant) -> int | None:
    value = variant.value
    return value if isinstance(value, int) and not isinstance(value, bool) else None
