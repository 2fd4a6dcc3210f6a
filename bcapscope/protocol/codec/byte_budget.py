"""A common limit for the bytes in several buffers."""

from __future__ import annotations

from bcapscope.protocol.codec.frame_content import LARGEST_FRAME

DEFAULT_BYTE_BUDGET = 2 * LARGEST_FRAME
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
