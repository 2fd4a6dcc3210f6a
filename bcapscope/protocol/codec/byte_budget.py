"""A limit on bytes that several buffers share."""

from __future__ import annotations

DEFAULT_BYTE_BUDGET = 32 * 1024 * 1024
"""Bytes of unfinished frames and of segments out of order that one program holds, unless it sets another
bound: two frames of the largest size."""


class ByteBudget:
    """Counts bytes that several buffers hold.

    Attributes:
        limit: bytes that they may hold together.
        held: bytes that they hold.
    """

    __slots__ = ("held", "limit")

    def __init__(self, limit: int = DEFAULT_BYTE_BUDGET) -> None:
        self.limit = limit
        self.held = 0

    @property
    def is_exceeded(self) -> bool:
        """Whether buffers must release what they can."""
        return self.held > self.limit
