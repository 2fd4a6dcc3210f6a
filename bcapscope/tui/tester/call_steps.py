"""Steps that make calls for the widgets, in the event loop of a `ControllerSession`."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass
from typing import Any, TypeAlias

from textual.message import Message

from bcapscope import messages
from bcapscope.client.handle_table import ObjectHandle
from bcapscope.errors import BcapError
from bcapscope.live.controller.controller_session import ControllerSession, NotArmedError
from bcapscope.live.controller.guided_connect import add_robot
from bcapscope.live.controller.history_record import HistoryRecord, RecordOutcome
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.command_catalogue import call_name
from bcapscope.protocol.tables.function_table import FUNCTIONS, Function, ObjectClass
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.render.escape import printable
from bcapscope.render.value_text import reply_values_text
from bcapscope.tui.app import BcapApp
from bcapscope.tui.controller_access.call_history import failure_text
from bcapscope.tui.tester.result_view import ResultView

CallStep: TypeAlias = Callable[[ControllerSession], Coroutine[Any, Any, HistoryRecord]]
"""Function that makes calls, and returns the record of the last call."""

_MAX_NOTICE = 300


class CallNotice:
    """Shows a call's result as a temporary message, if the call does not come from a form."""

    def __init__(self, app: BcapApp) -> None:
        self._app = app

    def show_pending(self) -> None:
        """Show nothing until the call ends."""

    def show_record(self, record: HistoryRecord) -> None:
        name = printable(call_name(record.function_id, record.arguments))
        if record.outcome is RecordOutcome.ANSWERED and record.reply is not None:
            text = f"{name}: {hresult_name(record.reply.code)} {reply_values_text(record.reply)}"
            self._app.show_message(text[:_MAX_NOTICE])
        else:
            self._app.show_message(f"{name}: {failure_text(record)}", "error")

    def show_error(self, reason: str) -> None:
        self._app.show_message(reason[:_MAX_NOTICE], "error")


@dataclass
class CallWanted(Message):
    """The user wants to run `step`. If `step` returns a record, even of a failed call, `done` is called."""

    result_display: ResultView | CallNotice
    step: CallStep
    done: Callable[[], object] = lambda: None


class ObjectMissingError(BcapError):
    """A call needs an object that the user has not opened."""


def function_step(
    function: Function, values: tuple[Variant, ...], subject: ObjectHandle | None = None
) -> CallStep:
    """Return a step that calls a function with `values`, the arguments without the handle. The step puts
    the handle of `subject` before `values`. If `subject` is None, the step uses the selected object of the
    function's class.
    """

    async def step(session: ControllerSession) -> HistoryRecord:
        if not function.takes_handle:
            return await session.call(function, values)
        handle = Variant(VT.I4, (subject or _selected_object(session, function.owner)).handle)
        return await session.call(function, (handle, *values))

    return step


def repeating_step(record: HistoryRecord) -> CallStep:
    """Return a step that repeats an earlier call unchanged, with the same handle."""
    function = FUNCTIONS.get(record.function_id)
    if function is None:
        return lambda session: session.send_raw(record.sent_packets[0].item.raw)
    return lambda session: session.call(function, record.arguments)


def opening_step(parent: ObjectClass, kind: ObjectClass, name: str, option: str) -> CallStep:
    """Return a step that opens an object below the selected `parent` object. A new robot is selected."""

    async def step(session: ControllerSession) -> HistoryRecord:
        if kind is ObjectClass.ROBOT:
            return await add_robot(session, name, option)
        await session.open_object(_selected_object(session, parent), kind, name, option)
        return session.last_record

    return step


def _selected_object(session: ControllerSession, kind: ObjectClass) -> ObjectHandle:
    """Return the most recently opened object of class `kind`; for ROBOT, prefer the selected robot."""
    status = session.status
    found = status.robot if kind is ObjectClass.ROBOT else None
    found = found or next((one for one in reversed(status.open_objects) if one.kind is kind), None)
    if found is None:
        key = "tester.missing" if status.is_connected else "tester.not_connected"
        raise ObjectMissingError(messages.Message(key, kind=kind))
    return found


async def run_armed(
    session: ControllerSession, ask_to_arm: Callable[[], Awaitable[bool]], step: CallStep
) -> HistoryRecord:
    """Run a step. If the step raises `NotArmedError`, ask the user to arm, then run the step again."""
    try:
        return await session.run_in_loop(step(session))
    except NotArmedError:
        if not await ask_to_arm():
            raise
    return await session.run_in_loop(step(session))
