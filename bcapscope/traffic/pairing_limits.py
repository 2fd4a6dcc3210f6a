"""Limits on the memory of open calls in one conversation."""

from __future__ import annotations

MAX_EXTRA_FRAMES = 65536
"""Maximum number of retries, notices and further replies of a conversation's open calls. These frames take
about 30 MB of memory. The call that exceeds the limit is evicted with all earlier calls, and its further
frames start another call. The older C client retries without end (start-jsk/denso b-Cap.c). At one retry
every 20 ms, such a client reaches the limit within 20 minutes.
"""

FRAME_COST = 512
"""Overhead of a frame in bytes."""

LARGE_CALL = 64 * 1024
"""Maximum size in bytes of a settled call that is kept in memory as the newest call."""
