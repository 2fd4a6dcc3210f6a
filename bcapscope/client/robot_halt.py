"""Robot_Halt, said until the controller has taken it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from bcapscope.client.session import Session
from bcapscope.errors import ControllerError
from bcapscope.protocol.retry.requester import RetryPolicy
from bcapscope.protocol.tables.hresult import E_BUSY

HALT_RETRY_POLICY = RetryPolicy(16_000_000, 60)
"""Tries of one call: often, and for a second."""

_MAX_CALLS, _BUSY_PAUSE = 50, 10_000_000


async def halt_robot(session: Session, robot: int, pause: Callable[[int], Awaitable[None]]) -> None:
    """Stop the arm at once.

    A controller that is at another call of the connection says that it is busy, or says nothing until it is
    done with that (orin_bcap C/src/bCAPServer/bcap_server.c).

    Args:
        session: to say it on.
        robot: handle.
        pause: lets so many ns pass.

    Raises:
        ControllerError: it was refused.
        CallTimeout: no try was answered.
        ConnectionError: the link is gone.
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
