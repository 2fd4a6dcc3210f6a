"""Send Robot_Halt until the controller accepts it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from bcapscope.client.session import Session
from bcapscope.errors import ControllerError
from bcapscope.protocol.retry.requester import RetryPolicy
from bcapscope.protocol.tables.hresult import E_BUSY

HALT_RETRY_POLICY = RetryPolicy(16_000_000, 60)
"""Retry policy of one Robot_Halt call: an attempt every 16 ms, for about a second."""

_MAX_CALLS, _BUSY_PAUSE = 50, 10_000_000


async def halt_robot(session: Session, robot: int, pause: Callable[[int], Awaitable[None]]) -> None:
    """Stop the arm at once.

    `pause` waits for a number of ns. While a controller executes another call of the connection, the
    controller replies that it is busy, or sends no reply until that call ends (orin_bcap
    C/src/bCAPServer/bcap_server.c).

    Raises:
        ControllerError: The controller refused Robot_Halt.
        CallTimeout: No attempt was answered.
        ConnectionError: The link is lost.
    """
    usual = session.retry_policies
    session.retry_policies = usual._replace(others=HALT_RETRY_POLICY)
    try:
        for left in reversed(range(_MAX_CALLS)):
            try:
                await session.invoke("Robot_Halt", robot, "")
                return
            except ControllerError as error:
                if error.hresult != E_BUSY or not left:
                    raise
            await pause(_BUSY_PAUSE)
    finally:
        session.retry_policies = usual
