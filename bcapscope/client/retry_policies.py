"""Where controllers listen, how long to wait for them and how often to ask again."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.protocol.retry.requester import RetryPolicy

DEFAULT_PORT = 5007
"""Where controllers listen (orin_bcap C/include/bcap_common.h)."""

_MS = 1_000_000


class RetryPolicies(NamedTuple):
    """How long to wait and how often to ask again (DENSO Wave 2009, How to use the Slave mode).

    Attributes:
        others: for all calls but slvMove; where these are the usual ones, with a try less while the robot is
            in an Async mode.
        sync: for slvMove in a mode that is not Async: 2 ms, 7 retries, together two control periods.
        asynchronous: for slvMove in an Async mode, where the next set point is due anyway.
    """

    others: RetryPolicy = RetryPolicy(1000 * _MS, 4)
    sync: RetryPolicy = RetryPolicy(2 * _MS, 7)
    asynchronous: RetryPolicy = RetryPolicy(2 * _MS, 0)


DEFAULT_RETRY_POLICIES = RetryPolicies()
"""What DENSO recommends."""

OTHERS_IN_ASYNC_MODE = RetryPolicy(1000 * _MS, 3)
"""What DENSO recommends for all calls but slvMove in an Async mode."""
