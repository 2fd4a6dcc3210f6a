"""A conversation with one controller: calls by name, how long they may take, and what is to be let go."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from typing import Protocol, TypeAlias

from bcapscope.client.caller import Caller, Listener, Observer
from bcapscope.client.paces import OTHERS_IN_ASYNC, PACES, PORT, Paces
from bcapscope.client.target import Target
from bcapscope.client.values import arguments_of
from bcapscope.errors import BcapError, ControllerError, ExchangeTimeout
from bcapscope.protocol.commands import call_name, command_name
from bcapscope.protocol.convention import Convention
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.functions import FUNCTIONS, Function, ObjectClass, function_by_name
from bcapscope.protocol.hresult import describe, hresult_name
from bcapscope.protocol.requester import Answered, Pace, Refused, Settled
from bcapscope.protocol.slavemode import mode_value
from bcapscope.protocol.variant import VT, Variant
from bcapscope.transport.link import Carrier, Link, Receiver
from bcapscope.transport.memory import MemoryLink
from bcapscope.transport.tcp import open_tcp
from bcapscope.transport.udp import open_udp

Opener: TypeAlias = Callable[[Receiver], Awaitable[Link]]

_MS = 1_000_000
_SERVICE_START, _ROBOT_EXECUTE = 1, 64
_ASYNC = 0x100
_ONCE = Pace(_MS, 0)


def over_udp(host: str, port: int = PORT) -> Opener:
    """Reach a controller over UDP."""
    return lambda receiver: open_udp(host, port, receiver)


def over_tcp(host: str, port: int = PORT) -> Opener:
    """Reach a controller over TCP."""
    return lambda receiver: open_tcp(host, port, receiver)


def over_link(link: MemoryLink) -> Opener:
    """Reach a controller in this process."""

    async def open_it(receiver: Receiver) -> Link:
        link.receiver = receiver
        return link

    return open_it


class Exchanger(Protocol):
    """What a session makes its calls with, such as a `Caller`."""

    @property
    def link(self) -> Carrier: ...

    async def exchange(self, function_id: int, arguments: Sequence[Variant], pace: Pace) -> Settled:
        """Make a call and return how it ended; raises as `Caller.exchange`."""

    def close(self) -> None:
        """Close the link."""


class Session:
    """Makes calls and remembers what they opened.

    On TCP a call has one try, which is given the time of all tries, and slvMove is given that of other calls,
    since TCP itself takes longer than a set point to send again what was lost.

    Attributes:
        paces: of the calls to come.
    """

    def __init__(self, caller: Exchanger, paces: Paces) -> None:
        self.paces = paces
        self._caller = caller
        self._open: list[tuple[Function, int | None]] = []
        self._modes: dict[int, int] = {}
        self._starting = False

    @property
    def exchanger(self) -> Exchanger:
        """What the calls are made with."""
        return self._caller

    async def exchange(self, function_id: int, arguments: Sequence[Variant]) -> Settled:
        """Make a call and return how it ended.

        Raises:
            LocalProtocolError: it cannot be sent, see `Requester.call`.
            ConnectionError: the link is gone.
        """
        pace = self.pace(function_id, arguments)
        mode = _slave_mode(function_id, arguments)
        robot = _handle(arguments)
        before = self._modes.get(robot, 0)
        # What is given up on the way may still be done.
        self._starting = function_id == _SERVICE_START
        if mode:
            self._modes[robot] = mode
        settled = await self._caller.exchange(function_id, arguments, pace)
        self._starting = False
        if isinstance(settled, Answered):
            self._note(function_id, arguments, settled.reply)
        elif mode and isinstance(settled, Refused):
            self._modes[robot] = before
        return settled

    async def call(self, function_id: int, arguments: Sequence[Variant]) -> Frame:
        """Make a call and return the reply.

        Raises:
            ControllerError: the controller refused it.
            ExchangeTimeout: no try was answered in time.
            LocalProtocolError: it cannot be sent, see `Requester.call`.
            ConnectionError: the link is gone.
        """
        settled = await self.exchange(function_id, arguments)
        if isinstance(settled, Answered):
            return settled.reply
        name = call_name(function_id, arguments)
        if isinstance(settled, Refused):
            code = settled.reply.code
            raise ControllerError(name, code, hresult_name(code), describe(code).text)
        raise ExchangeTimeout(name, settled.attempts)

    async def invoke(self, name: str, *values: object) -> Frame:
        """Call a function by its name; as `call`, with Python values for arguments."""
        function = function_by_name(name)
        assert function is not None, name
        return await self.call(function.id, arguments_of(function, values))

    async def close(self) -> None:
        """Leave slave mode and let go of what is open, newest first; then close the link.

        Where the peer no longer answers it is told that this is the end: a controller that is only busy, with
        a motion that nobody waits for any more, finds that when it is done. The rest is left to it.
        """
        try:
            if self._starting:
                patience = min(self.paces.others.timeout, PACES.others.timeout)
                self.paces = self.paces._replace(others=Pace(patience, 0))  # who is silent may not be there
                await self._leave("Service_Stop")
            for handle, mode in self._modes.items():
                if mode:
                    await self._leave("Robot_Execute", handle, "slvChangeMode", Variant(VT.I4, 0))
            for function, opened in reversed(self._open.copy()):
                await self._leave(function.name, *(() if opened is None else (opened,)))
        except ExchangeTimeout:
            await self._stop_unanswered()
        except OSError:
            pass
        finally:
            self._caller.close()

    async def _stop_unanswered(self) -> None:
        if any(function.releases is ObjectClass.SERVICE for function, _ in self._open):
            self.paces = self.paces._replace(others=_ONCE)
            with suppress(ExchangeTimeout, OSError):
                await self._leave("Service_Stop")

    async def _leave(self, name: str, *values: object) -> None:
        try:
            await self.invoke(name, *values)
        except ExchangeTimeout:
            raise
        except BcapError:
            pass  # what is refused here was let go before, by the controller or together with its owner

    def pace(self, function_id: int, arguments: Sequence[Variant]) -> Pace:
        """Return how long this call may take, in the slave mode that the robot is in."""
        paces = self.paces
        if not self._caller.link.datagrams:
            return Pace(paces.others.timeout * (paces.others.retries + 1), 0)
        if command_of(function_id, arguments) != "slvmove":
            in_async = paces.others == PACES.others and any(mode & _ASYNC for mode in self._modes.values())
            return OTHERS_IN_ASYNC if in_async else paces.others
        return paces.asynchronous if self._modes.get(_handle(arguments), 0) & _ASYNC else paces.sync

    def _note(self, function_id: int, arguments: Sequence[Variant], reply: Frame) -> None:
        """Remember what a successful call opened, closed or changed."""
        function = FUNCTIONS.get(function_id)
        if function is None:
            return
        if function.creates is not None:
            handle = None if function_id == _SERVICE_START else _result_handle(reply)
            release = next(one for one in FUNCTIONS.values() if one.releases is function.creates)
            self._open.append((release, handle))
        if function.releases is not None:
            gone = (function, _handle(arguments) if arguments else None)
            if gone in self._open:
                self._open.remove(gone)
        mode = _slave_mode(function_id, arguments)
        if mode is not None:
            self._modes[_handle(arguments)] = mode


def command_of(function_id: int, arguments: Sequence[Variant]) -> str:
    """Return the command of a Robot_Execute in lower case, else nothing."""
    return command_name(function_id, arguments).casefold() if function_id == _ROBOT_EXECUTE else ""


def _slave_mode(function_id: int, arguments: Sequence[Variant]) -> int | None:
    """Return the slave mode that a call asks for; None if it asks for none."""
    if command_of(function_id, arguments) != "slvchangemode" or len(arguments) < 3:
        return None
    return mode_value(arguments[2]) or 0


def _handle(arguments: Sequence[Variant]) -> int:
    value = arguments[0].value if arguments else None
    return value if isinstance(value, int) else 0


def _result_handle(reply: Frame) -> int:
    return _handle(reply.variants[:1])


@asynccontextmanager
async def open_session(
    open_link: Opener,
    *,
    convention: Convention | None = None,
    paces: Paces = PACES,
    observer: Observer | None = None,
    listener: Listener | None = None,
) -> AsyncIterator[Session]:
    """Open a link, and at the end of the block let go of all that calls have opened, however it ends.

    Args:
        open_link: `over_udp`, `over_tcp` or `over_link`.
        convention: of reserved; that of DENSO's slides on UDP and 0 on TCP unless given.
        paces: how long to wait and how often to ask again.
        observer: sees every frame.
        listener: hears all that happens.

    Raises:
        OSError: there is no way to the controller, or it does not listen.
    """
    caller = Caller(observer, listener)
    link = await open_link(caller)
    caller.attach(link, convention or (Convention.SEED if link.datagrams else Convention.TCP0))
    session = Session(caller, paces)
    try:
        yield session
    finally:
        await session.close()


def open_target(
    target: Target, observer: Observer | None = None, listener: Listener | None = None
) -> AbstractAsyncContextManager[Session]:
    """Open a session with a controller, as `open_session`."""
    opener = (over_tcp if target.tcp else over_udp)(target.host, target.port)
    return open_session(
        opener, convention=target.convention, paces=target.paces, observer=observer, listener=listener
    )
