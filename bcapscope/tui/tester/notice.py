"""Answers that have no field of their own are shown as messages for a while."""

from __future__ import annotations

from bcapscope.protocol.commands import call_name
from bcapscope.protocol.hresult import hresult_name
from bcapscope.render.escape import printable
from bcapscope.render.result import reply_result
from bcapscope.tui.app import Scope
from bcapscope.tui.desk.record import Ending, Record, why

_LONGEST = 300


class Notice:
    """Shows how a call ended."""

    def __init__(self, app: Scope) -> None:
        self._app = app

    def begin(self) -> None:
        """Say nothing yet."""

    def take(self, record: Record) -> None:
        """Show how the call ended."""
        name = printable(call_name(record.function_id, record.arguments))
        if record.ending is Ending.ANSWERED and record.reply is not None:
            text = f"{name}: {hresult_name(record.reply.code)} {reply_result(record.reply)}"
            self._app.tell(text[:_LONGEST])
        else:
            self._app.tell(f"{name}: {why(record)}", "error")

    def fail(self, reason: str) -> None:
        """Show why nothing was sent, or what broke."""
        self._app.tell(reason[:_LONGEST], "error")
