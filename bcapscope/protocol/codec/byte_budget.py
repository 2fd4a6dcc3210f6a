"""A limit on the bytes that several buffers hold together."""

from __future__ import annotations

DEFAULT_BYTE_BUDGET = 32 * 1024 * 1024
"""Bytes of unfinished frames and out-of-order segments that one program holds, unless it sets another limit:
two frames of the largest size."""


class ByteBudget:
    """Counts the bytes that several buffers hold.

    Attributes:
        limit: Bytes that they may hold together.
        held: Bytes that they hold now.
    """

    def __init__(self, limit: int = DEFAULT_BYTE_BUDGET) -> None:
        self.limit = limit
        self.held = 0

    @property
    def is_exceeded(self) -> bool:
        return self.held > self.limit
