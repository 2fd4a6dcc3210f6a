"""Requests of the Tester's widgets. The screen carries them out and passes the result to the sender."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from textual.message import Message

from bcapscope.client.handle_table import ObjectHandle
from bcapscope.live.controller.history_record import HistoryRecord
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.tables.function_table import Function, ObjectClass


class ResultDisplay(Protocol):
    """A widget that shows the outcome of its request."""

    def show_pending(self) -> None:
        """Show that the request is under way."""

    def show_record(self, record: HistoryRecord) -> None:
        """Show how the call ended."""

    def show_error(self, reason: str) -> None:
        """Show why nothing was sent, or which error occurred."""


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
        values: Arguments without the handle.
        subject: Object of the call; None for the selected object of its class.
    """

    result_display: ResultDisplay
    function: Function
    values: tuple[Variant, ...]
    subject: ObjectHandle | None = None


@dataclass
class OpenWanted(Message):
    """The user wants to open an object of the controller or of the selected robot: of the class `parent`."""

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
