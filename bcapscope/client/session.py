"""A client's session with one controller: makes calls with retries, and releases open objects at the end."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from typing import Protocol, TypeAlias

from bcapscope.client.caller import Caller, EventListener, Observer
from bcapscope.client.controller_target import (
    DEFAULT_PORT,
    DEFAULT_RETRY_POLICIES,
    OTHERS_IN_ASYNC_MODE,
    ControllerTarget,
    RetryPolicies,
)
from bcapscope.client.handle_table import HandleTable, first_number
from bcapscope.errors import BcapError, CallTimeout, ControllerError
from bcapscope.protocol.closing_calls import closing_calls
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import Variant, integer_value
from bcapscope.protocol.guard import needs_arming
from bcapscope.protocol.retry.requester import CallAnswered, CallRefused, RequesterOutcome, RetryPolicy
from bcapscope.protocol.retry.reserved_convention import ReservedConvention, client_conventions
from bcapscope.protocol.tables.command_catalogue import call_name, command_name, command_parameter
from bcapscope.protocol.tables.function_table import FUNCTIONS, ObjectClass, function_by_name
from bcapscope.protocol.tables.hresult import E_BUSY, describe_hresult, hresult_name
from bcapscope.protocol.variant_values import arguments_of
from bcapscope.transport.peer_link import Link, LinkReceiver
from bcapscope.transport.socket_link import open_tcp, open_udp

LinkOpener: TypeAlias = Callable[[LinkReceiver], Awaitable[Link]]

_MS = 1_000_000
_SERVICE_START, _SERVICE_STOP, _ROBOT_EXECUTE = 1, 2, 64
_ASYNC = 0x100
_TRY_ONCE = RetryPolicy(_MS, 0)

HALT_RETRY_POLICY = RetryPolicy(16_000_000, 60)
"""One attempt of Robot_Halt every 16 ms, for about a second."""

_MAX_CALLS, _BUSY_PAUSE = 50, 10_000_000


def over_udp(host: str, port: int = DEFAULT_PORT) -> LinkOpener:
    return lambda receiver: open_udp(host, port, receiver)


def over_tcp(host: str, port: int = DEFAULT_PORT) -> LinkOpener:
    return lambda receiver: open_tcp(host, port, receiver)


class BaseCaller(Protocol):
    """Interface through which a session makes its calls. Each method works as in `Caller`."""

    @property
    def link(self) -> Link: ...

    async def perform_call(
        self, function_id: int, arguments: Sequence[Variant], retry_policy: RetryPolicy
    ) -> RequesterOutcome:
        """Make a call and return its outcome. Raises what `Caller.perform_call` raises."""

    def close(self) -> None:
        """Close the link."""


class Session:
    """Makes calls to a controller, and keeps the handles of the objects that these calls opened.

    Over TCP, a call has only one attempt, whose timeout is as long as all UDP attempts together.
    Over TCP, slvMove has the same timeout as other calls, because TCP needs longer than a cycle time to
    retransmit lost data.

    Attributes:
        retry_policies: Retry policies for all further calls.
        check_armed: Function that runs before each call that needs arming; an exception prevents the call.
    """

    def __init__(self, caller: BaseCaller, retry_policies: RetryPolicies) -> None:
        self.retry_policies = retry_policies
        self.caller = caller
        self.handles = HandleTable()
        self.check_armed: Callable[[], None] | None = None
        self._slave_modes: dict[int, int] = {}
        self._is_starting = False

    async def perform_call(self, function_id: int, arguments: Sequence[Variant]) -> RequesterOutcome:
        """Make a call and return its outcome. Raises LocalProtocolError and ConnectionError."""
        if self.check_armed is not None and self.needs_arming(function_id, arguments):
            self.check_armed()
        pace = self.retry_policy_for(function_id, arguments)
        mode = requested_slave_mode(function_id, arguments)
        robot = first_number(arguments) or 0
        before = self._slave_modes.get(robot, 0)
        # Record the effect before the call, because the controller may execute the call even if this task is
        # cancelled.
        self._is_starting = function_id == _SERVICE_START
        if mode:
            self._slave_modes[robot] = mode
        settled = await self.caller.perform_call(function_id, arguments, pace)
        self._is_starting = False
        if isinstance(settled, CallAnswered):
            self.record_call(function_id, arguments, settled.reply)
        elif mode and isinstance(settled, CallRefused):
            self._slave_modes[robot] = before
        return settled

    async def call(self, function_id: int, arguments: Sequence[Variant]) -> Frame:
        """Make a call and return the reply.

        Raises ControllerError if the controller refuses the call, and CallTimeout if no reply arrives in
        time. Raises LocalProtocolError if the call cannot be sent, and ConnectionError if the link is lost.
        """
        settled = await self.perform_call(function_id, arguments)
        if isinstance(settled, CallAnswered):
            return settled.reply
        name = call_name(function_id, arguments)
        if isinstance(settled, CallRefused):
            code = settled.reply.code
            raise ControllerError(name, code, hresult_name(code), describe_hresult(code).meaning)
        raise CallTimeout(name, settled.attempts)

    async def invoke(self, name: str, *values: object) -> Frame:
        """Call a b-CAP function by its name, with Python values as arguments. Raises what `call` raises."""
        function = function_by_name(name)
        assert function is not None, name
        return await self.call(function.id, arguments_of(function, values))

    async def close(self) -> None:
        """Leave slave mode, release all open objects, newest first, and close the link.

        If the controller no longer replies, the session sends only Service_Stop, once. A controller that is
        busy with a motion reads Service_Stop when the motion ends.
        """
        try:
            if self._is_starting:
                patience = min(self.retry_policies.others.timeout, DEFAULT_RETRY_POLICIES.others.timeout)
                # Only one attempt, because there may be no controller at this address.
                once = RetryPolicy(patience, 0)
                self.retry_policies = self.retry_policies._replace(others=once)
                await self._call_ignoring_refusal(_SERVICE_STOP, ())
            robots = [handle for handle, mode in self._slave_modes.items() if mode]
            objects = [(opened.kind, opened.handle) for opened in self.handles.unreleased_handles()]
            stops = self.handles.is_service_started
            for function_id, arguments in closing_calls(robots, (), objects, stops_service=stops):
                await self._call_ignoring_refusal(function_id, arguments)
        except CallTimeout:
            if self.handles.is_service_started:
                self.retry_policies = self.retry_policies._replace(others=_TRY_ONCE)
                with suppress(CallTimeout, OSError):
                    await self._call_ignoring_refusal(_SERVICE_STOP, ())
        except OSError:
            pass
        finally:
            self.caller.close()

    async def _call_ignoring_refusal(self, function_id: int, arguments: Sequence[Variant]) -> None:
        try:
            await self.call(function_id, arguments)
        except CallTimeout:
            raise
        except BcapError:
            # A refusal is no problem: the controller may have released the object together with its parent.
            pass

    def retry_policy_for(self, function_id: int, arguments: Sequence[Variant]) -> RetryPolicy:
        """Return the retry policy of a call. Over UDP, the retry policy depends on the slave mode."""
        paces = self.retry_policies
        if not self.caller.link.datagrams:
            return RetryPolicy(paces.others.timeout * (paces.others.retries + 1), 0)
        if command_of(function_id, arguments) == "slvmove":
            mode = self._slave_modes.get(first_number(arguments) or 0, 0)
            return paces.asynchronous if mode & _ASYNC else paces.sync
        is_async = any(mode & _ASYNC for mode in self._slave_modes.values())
        is_default = paces.others == DEFAULT_RETRY_POLICIES.others
        return OTHERS_IN_ASYNC_MODE if is_async and is_default else paces.others

    def needs_arming(self, function_id: int, arguments: Sequence[Variant]) -> bool:
        """Return whether a call can energise or move the robot. The answer for
        Variable_PutValue depends on the variable's name and the new value.
        """
        variable = self.handles.find(ObjectClass.VARIABLE, first_number(arguments))
        return needs_arming(function_id, arguments, "" if variable is None else variable.label)

    def record_call(self, function_id: int, arguments: Sequence[Variant], reply: Frame) -> None:
        """Record what a successful call opened, released or changed. Recording a call twice is safe."""
        function = FUNCTIONS.get(function_id)
        if function is None:
            return
        self.handles.record_call(function, arguments, reply)
        mode = requested_slave_mode(function_id, arguments)
        if mode is not None:
            self._slave_modes[first_number(arguments) or 0] = mode


async def halt_robot(session: Session, robot: int, pause: Callable[[int], Awaitable[None]]) -> None:
    """Stop the robot at once. Raises what `Session.call` raises. `pause` waits for the given number of ns.

    While another call of the connection runs, the controller replies that it is busy, or does not reply
    (orin_bcap C/src/bCAPServer/bcap_server.c).
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


def command_of(function_id: int, arguments: Sequence[Variant]) -> str:
    """Return the command of a Robot_Execute in lower case; "" for any other call."""
    command = command_name(function_id, arguments) if function_id == _ROBOT_EXECUTE else None
    return (command or "").casefold()


def requested_slave_mode(function_id: int, arguments: Sequence[Variant]) -> int | None:
    """Return the slave mode that a call requests; None if the call does not change slave mode."""
    parameter = command_parameter(arguments)
    if parameter is None or command_of(function_id, arguments) != "slvchangemode":
        return None
    return integer_value(parameter) or 0


@asynccontextmanager
async def open_session(
    open_link: LinkOpener,
    *,
    convention: ReservedConvention | None = None,
    retry_policies: RetryPolicies = DEFAULT_RETRY_POLICIES,
    observer: Observer | None = None,
    listener: EventListener | None = None,
    fails_if_refused: bool = False,
) -> AsyncIterator[Session]:
    """Open a link, or raise OSError. At the end of the block, the session releases the objects that its calls
    opened.

    `open_link` is the result of `over_udp` or `over_tcp`. The default `convention` is `SEED` over UDP, and
    `TCP0` over TCP. `observer` receives every frame, and `listener` every event. `Caller` explains
    `fails_if_refused`.
    """
    caller = Caller(observer, listener, fails_if_refused)
    link = await open_link(caller)
    caller.attach(link, convention or client_conventions(link.datagrams)[0])
    session = Session(caller, retry_policies)
    try:
        yield session
    finally:
        await session.close()


def open_target_session(
    target: ControllerTarget,
    observer: Observer | None = None,
    listener: EventListener | None = None,
    fails_if_refused: bool = False,
) -> AbstractAsyncContextManager[Session]:
    opener = (over_tcp if target.tcp else over_udp)(target.host, target.port)
    return open_session(
        opener,
        convention=target.convention,
        retry_policies=target.retry_policies,
        observer=observer,
        listener=listener,
        fails_if_refused=fails_if_refused,
    )
