"""Default port, timeouts and numbers of retries."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.protocol.retry.requester import RetryPolicy

DEFAULT_PORT = 5007
"""Port on which controllers listen (orin_bcap C/include/bcap_common.h)."""

_MS = 1_000_000


class RetryPolicies(NamedTuple):
    """Timeouts and numbers of retries (DENSO Wave 2009, How to use the Slave mode).

    Attributes:
        others: For all calls but slvMove. While the robot is in an Async mode, the default policy has one
            retry less.
        sync: For slvMove in a mode that is not Async: 2 ms, 7 retries, together two control periods.
        asynchronous: For slvMove in an Async mode: no retry, because the next set point is due anyway.
    """

    others: RetryPolicy = RetryPolicy(1000 * _MS, 4)
    sync: RetryPolicy = RetryPolicy(2 * _MS, 7)
    asynchronous: RetryPolicy = RetryPolicy(2 * _MS, 0)


DEFAULT_RETRY_POLICIES = RetryPolicies()
"""Policies that DENSO recommends."""

OTHERS_IN_ASYNC_MODE = RetryPolicy(1000 * _MS, 3)
"""Policy that DENSO recommends for all calls but slvMove in an Async mode."""
