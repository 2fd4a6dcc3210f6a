"""Requests of the Tester's widgets.

The Tester's screen carries out the requests, and passes the result to the widget that sent the request.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from textual.message import Message

from bcapscope.client.handle_table import ObjectHandle
from bcapscope.live.controller.history_record import HistoryRecord
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.tables.function_table import Function, ObjectClass


class ResultDisplay(Protocol):
    """A widget that shows the outcome of the user's request."""

    def show_pending(self) -> None:
        """Show that a request is under way."""

    def show_record(self, record: HistoryRecord) -> None:
        """Show how the call ended."""

    def show_error(self, reason: str) -> None:
        """Show the error text `reason`: why nothing was sent, or what failed."""


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
    """The user wants to open an object of class `kind`, owned by the selected object of class `parent`."""

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
