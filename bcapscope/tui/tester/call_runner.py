"""Make the calls that widgets request. `ControllerSession` sends the calls to the controller, and the widgets
get the results.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass
from typing import Any, Protocol

from textual.message import Message

from bcapscope import messages
from bcapscope.client.handle_table import ObjectHandle
from bcapscope.errors import BcapError
from bcapscope.live.controller.controller_session import ControllerSession, NotArmedError
from bcapscope.live.controller.guided_connect import add_robot, start_robslave
from bcapscope.live.controller.history_record import HistoryRecord, RecordOutcome
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.command_catalogue import call_name
from bcapscope.protocol.tables.function_table import FUNCTIONS, Function, ObjectClass
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.render.escape import printable
from bcapscope.render.value_text import reply_values_text
from bcapscope.tui.app import BcapApp
from bcapscope.tui.controller_access.call_history import error_text, failure_text
from bcapscope.tui.reader_language import label


class ResultDisplay(Protocol):
    """A widget that shows the outcome of a request by the user."""

    def show_pending(self) -> None:
        """Show that a request was sent and has no result yet."""

    def show_record(self, record: HistoryRecord) -> None:
        """Show how the call ended."""

    def show_error(self, reason: str) -> None:
        """Show the error text `reason`, which says why nothing was sent or what failed."""


@dataclass
class ConnectWanted(Message):
    host: str
    port: int
    tcp: bool
    option: str


class DisconnectWanted(Message):
    """The user wants to disconnect."""


@dataclass
class CallWanted(Message):
    """The user wants to make a call.

    Attributes:
        values: Arguments of the call without the handle.
        subject: Object whose handle the call uses; None for the selected object of the function's class.
    """

    result_display: ResultDisplay
    function: Function
    values: tuple[Variant, ...]
    subject: ObjectHandle | None = None


@dataclass
class OpenWanted(Message):
    """The user wants to open an object of class `kind` through the selected object of class `parent`."""

    result_display: ResultDisplay
    parent: ObjectClass
    kind: ObjectClass
    name: str
    option: str


@dataclass
class RawWanted(Message):
    result_display: ResultDisplay
    raw: bytes


@dataclass
class RobSlaveWanted(Message):
    result_display: ResultDisplay


@dataclass
class WatchWanted(Message):
    """The user wants to watch an open variable."""

    variable: ObjectHandle


CallStep = Callable[[], Coroutine[Any, Any, HistoryRecord]]


_MAX_NOTICE = 300


class ObjectMissingError(BcapError):
    """A call needs an object that the user has not opened."""


class CallRunner:
    """Makes the calls that the Tester's widgets request, through a `ControllerSession`.

    The coroutines of this class run in the screen's event loop.
    """

    def __init__(self, session: ControllerSession, ask_to_arm: Callable[[], Awaitable[bool]]) -> None:
        self._session = session
        self._ask_to_arm = ask_to_arm

    async def make_call(self, wanted: CallWanted) -> None:
        function, values = wanted.function, wanted.values

        async def step() -> HistoryRecord:
            if not function.takes_handle:
                return await self._session.call(function, values)
            handle = Variant(VT.I4, (wanted.subject or self._object_of(function.owner)).handle)
            return await self._session.call(function, (handle, *values))

        await self._run_reported(wanted.result_display, step)

    async def repeat_call(self, result_display: ResultDisplay, record: HistoryRecord) -> None:
        """Repeat an earlier call unchanged, with the same handle."""
        function = FUNCTIONS.get(record.function_id)
        if function is None:
            await self.send_raw(RawWanted(result_display, record.sent_packets[0].item.raw))
            return
        await self._run_reported(result_display, lambda: self._session.call(function, record.arguments))

    async def send_raw(self, wanted: RawWanted) -> None:
        await self._run_reported(wanted.result_display, lambda: self._session.send_raw(wanted.raw))

    async def open_object(self, wanted: OpenWanted) -> bool:
        """Open an object. Return whether the call was made, even if it failed. A robot is also selected."""
        session = self._session

        async def step() -> HistoryRecord:
            if wanted.kind is ObjectClass.ROBOT:
                return await add_robot(session, wanted.name, wanted.option)
            parent = self._object_of(wanted.parent)
            await session.open_object(parent, wanted.kind, wanted.name, wanted.option)
            return session.last_record

        return await self._run_reported(wanted.result_display, step)

    async def run_robslave(self, result_display: ResultDisplay) -> None:
        await self._run_reported(result_display, lambda: start_robslave(self._session))

    def _object_of(self, kind: ObjectClass) -> ObjectHandle:
        """Return the selected robot if `kind` is robot. For any other class, return the most recently opened
        object of this class.
        """
        status = self._session.status
        found = status.robot if kind is ObjectClass.ROBOT else None
        found = found or next((one for one in reversed(status.open_objects) if one.kind is kind), None)
        if found is None:
            key = "tester.missing" if status.is_connected else "tester.not_connected"
            raise ObjectMissingError(messages.Message(key, kind=kind))
        return found

    async def _run_reported(self, result_display: ResultDisplay, step: CallStep) -> bool:
        """Run `step`, which makes calls, and show the outcome in a widget. If `step` needs arming, ask
        the user to arm first. Return whether the step ran.
        """
        result_display.show_pending()
        try:
            result_display.show_record(await run_armed(self._session, self._ask_to_arm, step))
        except asyncio.CancelledError:
            result_display.show_error(label("tester.cancelled"))
            raise
        except NotArmedError:
            result_display.show_error(label("tester.not_armed"))
        except (BcapError, OSError) as error:
            result_display.show_error(error_text(error))
        else:
            return True
        return False


async def run_armed(
    session: ControllerSession, ask_to_arm: Callable[[], Awaitable[bool]], step: CallStep
) -> HistoryRecord:
    """Run the function `step`, which makes calls, in the event loop of the `ControllerSession`. If `step`
    needs arming, ask the user to arm, then run `step` again.

    Raises:
        NotArmedError: The user refused to arm.
    """
    try:
        return await session.run_in_loop(step())
    except NotArmedError:
        if not await ask_to_arm():
            raise
    return await session.run_in_loop(step())


class CallNotice:
    """Shows the results of calls that have no result field, as temporary messages."""

    def __init__(self, app: BcapApp) -> None:
        self._app = app

    def show_pending(self) -> None:
        """Show nothing while the call runs. A message with the result appears when the call ends."""

    def show_record(self, record: HistoryRecord) -> None:
        name = printable(call_name(record.function_id, record.arguments))
        if record.outcome is RecordOutcome.ANSWERED and record.reply is not None:
            text = f"{name}: {hresult_name(record.reply.code)} {reply_values_text(record.reply)}"
            self._app.show_message(text[:_MAX_NOTICE])
        else:
            self._app.show_message(f"{name}: {failure_text(record)}", "error")

    def show_error(self, reason: str) -> None:
        self._app.show_message(reason[:_MAX_NOTICE], "error")
