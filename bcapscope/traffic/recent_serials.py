"""Table of the latest serials of one conversation, with a limited size."""

from __future__ import annotations

from typing import Generic, TypeVar

MAX_SERIALS = 1024
"""Minimum number of remembered serials: about one second of set points, if the client sends one every ms."""

Value = TypeVar("Value")


class RecentSerials(Generic[Value]):
    __slots__ = ("_earlier", "_latest")

    def __init__(self) -> None:
        self._latest: dict[int, Value] = {}
        self._earlier: dict[int, Value] = {}

    def get(self, serial: int) -> Value | None:
        return self._latest.get(serial) or self._earlier.get(serial)

    def put(self, serial: int, value: Value) -> None:
        """Remember a value, which must be truthy."""
        latest = self._latest
        latest[serial] = value
        if len(latest) >= MAX_SERIALS:
            self._earlier, self._latest = latest, {}
