"""A limit on bytes that several buffers share."""

from __future__ import annotations

MOST_HELD = 32 * 1024 * 1024
"""Bytes of unfinished frames and of segments out of order that one program holds, unless it sets another
bound: two frames of the largest size."""


class Budget:
    """Counts bytes that several buffers hold.

    Attributes:
        most: bytes that they may hold together.
        held: bytes that they hold.
    """

    __slots__ = ("held", "most")

    def __init__(self, most: int = MOST_HELD) -> None:
        self.most = most
        self.held = 0

    @property
    def is_exceeded(self) -> bool:
        """Whether buffers must release what they can."""
        return self.held > self.most
