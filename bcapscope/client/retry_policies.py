"""Default port, timeouts and numbers of retries of a client."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.protocol.retry.requester import RetryPolicy

DEFAULT_PORT = 5007
"""Port on which controllers listen (orin_bcap C/include/bcap_common.h)."""

_MS = 1_000_000


class RetryPolicies(NamedTuple):
    """Timeouts and numbers of retries (DENSO Wave 2009, How to use the Slave mode).

    Attributes:
        others: Policy for all calls but slvMove. In an Async mode, the default policy has one retry less.
        sync: Policy for slvMove in a mode that is not Async: 2 ms and 7 retries, together two cycle times.
        asynchronous: Policy for slvMove in an Async mode: no retry, because the next set point follows
            anyway.
    """

    others: RetryPolicy = RetryPolicy(1000 * _MS, 4)
    sync: RetryPolicy = RetryPolicy(2 * _MS, 7)
    asynchronous: RetryPolicy = RetryPolicy(2 * _MS, 0)


DEFAULT_RETRY_POLICIES = RetryPolicies()
"""Policies that DENSO recommends."""

OTHERS_IN_ASYNC_MODE = RetryPolicy(1000 * _MS, 3)
"""Policy that DENSO recommends in an Async mode for all calls but slvMove."""
