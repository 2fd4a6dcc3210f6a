"""A common limit for the bytes in several buffers."""

from __future__ import annotations

DEFAULT_BYTE_BUDGET = 32 * 1024 * 1024
"""Default limit, in bytes, for all buffers of one process: two frames of maximum size."""


class ByteBudget:
    """Limits how many bytes several buffers hold together. `held` is their present total; the owner of each
    buffer adds its bytes to `held` and subtracts them from it.
    """

    def __init__(self, limit: int = DEFAULT_BYTE_BUDGET) -> None:
        self.limit = limit
        self.held = 0

    @property
    def is_exceeded(self) -> bool:
        return self.held > self.limit
