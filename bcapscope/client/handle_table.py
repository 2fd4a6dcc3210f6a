"""Tracks the objects that a session has opened in the controller, by handle."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.tables.function_table import Function, ObjectClass


class ObjectHandle(NamedTuple):
    """An object that the client has opened. `parent` is None for a controller.

    `opened_with` holds the string arguments of the call that opened the object, such as name and option.
    """

    kind: ObjectClass
    handle: int
    opened_with: tuple[str, ...]
    parent: ObjectHandle | None

    @property
    def label(self) -> str:
        """Name for display: the first string of `opened_with`, or class and handle, such as `Message 3`."""
        return (self.opened_with[0] if self.opened_with else "") or f"{self.kind} {self.handle}"


class HandleTable:
    """Learns from successful calls which objects are open, and whether the service is started."""

    def __init__(self) -> None:
        self.is_service_started = False
        self._unreleased: dict[tuple[ObjectClass, int], ObjectHandle] = {}

    def record_call(self, function: Function, arguments: Sequence[Variant], reply: Frame) -> None:
        """Record a successful call. It is safe to record the same call twice."""
        handle = first_number(arguments)
        if function.creates is ObjectClass.SERVICE:
            self.is_service_started = True
        elif function.creates is not None:
            self._add(function.creates, arguments, self.find(function.owner, handle), reply)
        elif function.releases is ObjectClass.SERVICE:
            self.is_service_started = False
            self._unreleased.clear()
        elif function.releases is not None and handle is not None:
            self._unreleased.pop((function.releases, handle), None)

    def find(self, kind: ObjectClass, handle: int | None) -> ObjectHandle | None:
        found = None if handle is None else self._unreleased.get((kind, handle))
        return found if found is not None and self._is_open(found) else None

    def find_named(self, kind: ObjectClass, name: str, parent: ObjectHandle) -> ObjectHandle | None:
        found = (one for one in self._newest_first(kind) if one.label == name and one.parent == parent)
        return next(found, None)

    def latest(self, kind: ObjectClass) -> ObjectHandle | None:
        return next(self._newest_first(kind), None)

    def open_handles(self) -> tuple[ObjectHandle, ...]:
        return tuple(filter(self._is_open, self._unreleased.values()))

    def unreleased_handles(self) -> tuple[ObjectHandle, ...]:
        """List the objects that the client must still release, newest first.

        When a controller is disconnected, its objects are no longer open, but they remain in this list.
        """
        return tuple(reversed(self._unreleased.values()))

    def _add(
        self, kind: ObjectClass, arguments: Sequence[Variant], parent: ObjectHandle | None, reply: Frame
    ) -> None:
        handle = first_number(reply.variants)
        if handle is None:
            return
        texts = tuple(str(each.value) for each in arguments if isinstance(each.value, str))
        opened = ObjectHandle(kind, handle, texts, parent)
        if self._unreleased.get((kind, handle)) != opened:
            self._unreleased.pop((kind, handle), None)
            self._unreleased[kind, handle] = opened

    def _newest_first(self, kind: ObjectClass) -> Iterator[ObjectHandle]:
        return (one for one in reversed(self._unreleased.values()) if one.kind is kind and self._is_open(one))

    def _is_open(self, one: ObjectHandle) -> bool:
        """Return whether the client is still connected to the controller of the object."""
        root = one
        while root.parent is not None:
            root = root.parent
        return root.kind is not ObjectClass.CONTROLLER or (
            self._unreleased.get((root.kind, root.handle)) is root
        )


def first_number(values: Sequence[Variant]) -> int | None:
    """Return the first value if it is a whole number, such as a handle; else None."""
    value = values[0].value if values else None
    return value if isinstance(value, int) else None
