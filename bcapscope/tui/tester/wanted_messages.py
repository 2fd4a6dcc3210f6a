"""What the widgets of the Tester want done; the screen does it and gives the answer to whoever asked."""

from __future__ import annotations

from typing import Protocol

from textual.message import Message

from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.tables.function_table import Function, ObjectClass
from bcapscope.traffic.handle_table import ObjectHandle
from bcapscope.tui.controller_access.history_record import HistoryRecord


class ResultDisplay(Protocol):
    """Shows what becomes of what it wanted."""

    def show_pending(self) -> None:
        """Show that it is being done."""

    def show_record(self, record: HistoryRecord) -> None:
        """Show how the call ended."""

    def show_error(self, reason: str) -> None:
        """Show why nothing was sent, or what broke."""


class ConnectWanted(Message):
    """Connect to a controller."""

    def __init__(self, host: str, port: int, tcp: bool, option: str) -> None:
        super().__init__()
        self.host, self.port, self.tcp, self.option = host, port, tcp, option


class DisconnectWanted(Message):
    """Let go of the controller."""


class CallWanted(Message):
    """Make a call.

    Attributes:
        result_display: shows what becomes of it.
        function: to call.
        values: arguments, without the handle.
        subject: what it is asked of; None for the object of that class that is chosen.
    """

    def __init__(
        self,
        result_display: ResultDisplay,
        function: Function,
        values: tuple[Variant, ...],
        subject: ObjectHandle | None = None,
    ) -> None:
        super().__init__()
        self.result_display, self.function, self.values, self.subject = (
            result_display,
            function,
            values,
            subject,
        )


class OpenWanted(Message):
    """Open an object of the controller, or one of the robot that is chosen.

    Attributes:
        result_display: shows what becomes of it.
        parent: class of the object that it is asked of.
        kind: what is to be opened.
        name: its name.
        option: for opening it.
    """

    def __init__(
        self, result_display: ResultDisplay, parent: ObjectClass, kind: ObjectClass, name: str, option: str
    ) -> None:
        super().__init__()
        self.result_display, self.parent, self.kind, self.name, self.option = (
            result_display,
            parent,
            kind,
            name,
            option,
        )


class RawWanted(Message):
    """Send bytes as they are."""

    def __init__(self, result_display: ResultDisplay, raw: bytes) -> None:
        super().__init__()
        self.result_display, self.raw = result_display, raw


class RobSlaveWanted(Message):
    """Open the task RobSlave and start it."""

    def __init__(self, result_display: ResultDisplay) -> None:
        super().__init__()
        self.result_display = result_display


class WatchWanted(Message):
    """Read a variable again and again, or no more.

    Attributes:
        variable: an open variable.
        on: whether to.
    """

    def __init__(self, variable: ObjectHandle, on: bool) -> None:
        super().__init__()
        self.variable, self.on = variable, on
