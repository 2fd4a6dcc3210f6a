"""What a client has open: which object each handle stands for, and how it came to it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from bcapscope.protocol.frame import Frame
from bcapscope.protocol.functions import Function, ObjectClass
from bcapscope.protocol.variant import Variant

_ROOTS = (ObjectClass.SERVICE, ObjectClass.CONTROLLER)


class Opened(NamedTuple):
    """An object in the controller that we have a handle of.

    Attributes:
        kind: its class.
        handle: the number.
        asked: what it was asked for by, such as name and option; for a controller the four strings of
            Controller_Connect.
        parent: the object that it was asked of; None for a controller.
    """

    kind: ObjectClass
    handle: int
    asked: tuple[str, ...]
    parent: Opened | None

    @property
    def label(self) -> str:
        """Its name for people, `Message 3` where it has none."""
        return (self.asked[0] if self.asked else "") or f"{self.kind} {self.handle}"


class Book:
    """Follows the successful calls of one session and knows what is open."""

    def __init__(self) -> None:
        self._open: dict[tuple[ObjectClass, int], Opened] = {}

    def note(self, function: Function, arguments: Sequence[Variant], reply: Frame) -> Opened | None:
        """Take in a call that succeeded; return what it opened."""
        target = self.find(function.owner, _number(arguments[0]) if arguments else None)
        if function.creates is not None and function.creates is not ObjectClass.SERVICE:
            return self._add(function.creates, arguments, target, reply)
        if function.releases is ObjectClass.SERVICE:
            self._open.clear()
        elif target is not None and function.releases is not None:
            self._forget(target)
        return None

    def find(self, kind: ObjectClass, handle: int | None) -> Opened | None:
        """Return the object that a handle stands for."""
        return None if handle is None else self._open.get((kind, handle))

    def all(self, kind: ObjectClass | None = None) -> tuple[Opened, ...]:
        """List what is open, of one class or of all, in the order in which it was opened."""
        return tuple(one for one in self._open.values() if kind is None or one.kind is kind)

    def _add(
        self, kind: ObjectClass, arguments: Sequence[Variant], parent: Opened | None, reply: Frame
    ) -> Opened | None:
        handle = _number(reply.arguments[0].variant) if reply.arguments else None
        if handle is None:
            return None
        asked = tuple(str(each.value) for each in arguments if isinstance(each.value, str))
        opened = Opened(kind, handle, asked, parent)
        self._open.pop((kind, handle), None)
        self._open[kind, handle] = opened
        return opened

    def _forget(self, gone: Opened) -> None:
        """Forget an object; with a controller go all that were opened through it."""
        self._open.pop((gone.kind, gone.handle), None)
        if gone.kind in _ROOTS:
            self._open = {key: one for key, one in self._open.items() if not _is_below(one, gone)}


def _is_below(one: Opened, gone: Opened) -> bool:
    above = one.parent
    while above is not None and above != gone:
        above = above.parent
    return above is not None


def _number(variant: Variant) -> int | None:
    value = variant.value
    return value if isinstance(value, int) and not isinstance(value, bool) else None
