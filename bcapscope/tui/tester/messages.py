"""What the widgets of the Tester want done; the screen does it and gives the answer to whoever asked."""

from __future__ import annotations

from typing import Protocol

from textual.message import Message

from bcapscope.protocol.functions import Function, ObjectClass
from bcapscope.protocol.variant import Variant
from bcapscope.traffic.opened import Opened
from bcapscope.tui.desk.record import Record


class Asker(Protocol):
    """Shows what becomes of what it wanted."""

    def begin(self) -> None:
        """Show that it is being done."""

    def take(self, record: Record) -> None:
        """Show how the call ended."""

    def fail(self, reason: str) -> None:
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
        asker: shows what becomes of it.
        function: to call.
        values: arguments, without the handle.
        subject: what it is asked of; None for the object of that class that is chosen.
    """

    def __init__(
        self, asker: Asker, function: Function, values: tuple[Variant, ...], subject: Opened | None = None
    ) -> None:
        super().__init__()
        self.asker, self.function, self.values, self.subject = asker, function, values, subject


class OpenWanted(Message):
    """Open an object of the controller, or one of the robot that is chosen.

    Attributes:
        asker: shows what becomes of it.
        parent: class of the object that it is asked of.
        kind: what is to be opened.
        name: its name.
        option: for opening it.
    """

    def __init__(self, asker: Asker, parent: ObjectClass, kind: ObjectClass, name: str, option: str) -> None:
        super().__init__()
        self.asker, self.parent, self.kind, self.name, self.option = asker, parent, kind, name, option


class RawWanted(Message):
    """Send bytes as they are."""

    def __init__(self, asker: Asker, raw: bytes) -> None:
        super().__init__()
        self.asker, self.raw = asker, raw


class RobSlaveWanted(Message):
    """Open the task RobSlave and start it."""

    def __init__(self, asker: Asker) -> None:
        super().__init__()
        self.asker = asker


class WatchWanted(Message):
    """Read a variable again and again, or no more.

    Attributes:
        variable: an open variable.
        on: whether to.
    """

    def __init__(self, variable: Opened, on: bool) -> None:
        super().__init__()
        self.variable, self.on = variable, on
