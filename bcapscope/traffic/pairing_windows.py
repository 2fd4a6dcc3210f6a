"""How long a further frame of a call can follow: the time windows of `ConversationPairing`."""

from __future__ import annotations

COPIES_WITHIN_NS = 100_000_000
"""Maximum time in ns within which copies and reordered frames arrive: factory networks delay a frame by
milliseconds. No client restarts on the same port this fast without a Service_Start."""

RETRY_WITHIN_NS = 5_000_000_000
"""Maximum time in ns from a captured reply to a retry of its request. No client waits longer before a retry
(3 s in DENSO's ROS 2 driver, 1 s in DENSO Wave 2009)."""

LATE_WITHIN_NS = 1_000_000_000
"""Maximum time in ns to wait for a reply after the client began another call, if the controller has answered
a later call. A reply after this time is a stray reply that names its call."""

BUSY_WITHIN_NS = 30_000_000_000
"""Maximum time in ns to wait for a reply after the client began another call, if the controller has not
answered a later call. The controller may still be executing the call, because controllers answer in order."""

EXECUTION_NS = 180_000_000_000
"""Maximum time in ns without a frame of a call, if no later call was answered: the server's InvokeTimeout,
after which the server never answers (orin_bcap C/src/bCAPServer/bcap_server.c)."""
