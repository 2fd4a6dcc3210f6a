"""A dictionary of limited size."""

from __future__ import annotations

from typing import TypeVar

Key = TypeVar("Key")
Value = TypeVar("Value")


class BoundedDict(dict[Key, Value]):
    """Drops its oldest entry when an assignment exceeds `limit` entries. An entry becomes the newest when
    `table[key] = value` sets it; other methods, such as `setdefault`, ignore limit and order.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit

    def __setitem__(self, key: Key, value: Value) -> None:
        self.pop(key, None)
        dict.__setitem__(self, key, value)  # 40 ns faster than `super()`
        if len(self) > self._limit:
            del self[next(iter(self))]
