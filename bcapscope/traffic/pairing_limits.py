"""Limits on the memory of open calls in one conversation."""

from __future__ import annotations

MAX_EXTRA_FRAMES = 65536
"""Maximum number of retries, notices and further replies in all open calls of a conversation together. These
frames take about 30 MB of memory. If a call exceeds the limit, this call and all earlier calls are evicted.
Further frames of the evicted call start another call. The older C client retries without end (start-jsk/denso
b-Cap.c). A client that retries every 20 ms without end reaches the limit within 22 minutes.
"""

FRAME_COST = 512
"""Overhead of a frame in bytes."""

LARGE_CALL = 64 * 1024
"""Maximum size in bytes of a settled call that `ConversationPairing` keeps as the newest call."""
