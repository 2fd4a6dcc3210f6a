"""Execute the calls of one client, one after another: request frames in, reply frames out.

In DENSO's C server, a stuck call over UDP blocks all UDP clients. In the simulator, a stuck call blocks only
its own client.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from bcapscope.errors import TooLargeError
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import EMPTY, Variant
from bcapscope.protocol.tables.command_catalogue import command_name
from bcapscope.protocol.tables.function_table import FUNCTIONS, ResultKind
from bcapscope.protocol.tables.hresult import E_BUSY, E_NOTIMPL, E_TOO_MUCH_DATA
from bcapscope.simulator.call_outcome import CallResult, RunningCall
from bcapscope.simulator.client_session import ClientSession
from bcapscope.simulator.hosted_client import HostedClient
from bcapscope.simulator.machine import Machine
from bcapscope.simulator.profile import NoArgument

MAX_KEPT_REPLIES = 8
"""Maximum number of replies that are kept to answer retries. Each kept reply makes every call slower."""

_ROBOT_EXECUTE = 64
_FUNCTIONS_WITH_RESULT = frozenset(
    each.id for each in FUNCTIONS.values() if each.result is not ResultKind.NONE
)


class CallReport(NamedTuple):
    """A finished call with its result; `began` and `ended` are in ns."""

    client: int
    function_id: int
    arguments: tuple[Variant, ...]
    result: CallResult
    began: int
    ended: int


class CallExecutor(HostedClient):
    running: RunningCall | None = None

    def __init__(
        self, machine: Machine, number: int, udp: bool, report: Callable[[CallReport], None]
    ) -> None:
        profile = machine.profile
        super().__init__(udp, profile.replies, MAX_KEPT_REPLIES, profile.defects)
        self.session = ClientSession(machine, number)
        self._profile = profile
        self._report = report
        self._request: tuple[int, tuple[Variant, ...], int] = (0, (), 0)
        self._next_notice: int | None = None

    def poll(self, now: int) -> list[bytes]:
        if self.running is None:
            return []
        answer = self.running.poll(now)
        if answer is None:
            return self._due_notices(now)
        self.running = None
        reply = self._answer(answer, now)
        stuck, self._is_timed_out = self._is_timed_out, False
        return [*([] if stuck else [reply]), *self._start_waiting(now)]

    def due(self, now: int) -> int | None:
        if self.running is None:
            return None
        due = self.running.due(now)
        return due if self._next_notice is None else min(due, self._next_notice)

    def close(self) -> None:
        self.running = None
        super().close()
        self.session.end()

    def _start_call(self, frame: Frame, now: int) -> list[bytes]:
        arguments = frame.variants
        self._request = (frame.code, arguments, now)
        outcome = self.session.call(frame.code, arguments, now)
        if isinstance(outcome, CallResult):
            return [self._answer(outcome, now)]
        self.running = outcome
        self._next_notice = None if self.session.wdt is None else now + self.session.wdt
        return []

    def _due_notices(self, now: int) -> list[bytes]:
        if self._next_notice is None or now < self._next_notice or self.session.wdt is None:
            return []
        if now - self._request[2] >= self.session.invoke_timeout:
            self._is_timed_out = True
            self._next_notice = None
            frames = [self._responder.reply_unremembered(frame, E_BUSY) for frame in self._waiting]
            self._waiting.clear()
            return frames
        self._next_notice += self.session.wdt * ((now - self._next_notice) // self.session.wdt + 1)
        return [self._responder.executing_notice()]

    def _answer(self, answer: CallResult, now: int) -> bytes:
        function_id, arguments, began = self._request
        try:
            raw = self._responder.answer_call(answer.hresult, self._reply_arguments(function_id, answer))
        except TooLargeError:
            answer = CallResult(E_TOO_MUCH_DATA)
            raw = self._responder.answer_call(answer.hresult, self._reply_arguments(function_id, answer))
        self._report(CallReport(self.session.number, function_id, arguments, answer, began, now))
        return raw

    def _reply_arguments(self, function_id: int, answer: CallResult) -> tuple[Variant, ...]:
        """Return a reply's value. If a call produces no value, the profile chooses EMPTY or no VARIANT."""
        if function_id not in _FUNCTIONS_WITH_RESULT or answer.hresult == E_NOTIMPL:
            return ()
        if answer.value is not None:
            return (answer.value,)
        which = self._profile.no_argument
        if which is not NoArgument.SLVCHANGEMODE:
            return () if which is NoArgument.ALWAYS else (EMPTY,)
        command = command_name(function_id, self._request[1]) if function_id == _ROBOT_EXECUTE else None
        return () if (command or "").casefold() == "slvchangemode" else (EMPTY,)
