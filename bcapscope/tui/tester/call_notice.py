"""Shows the results of calls that have no result field as temporary messages."""

from __future__ import annotations

from bcapscope.protocol.tables.command_catalogue import call_name
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.render.escape import printable
from bcapscope.render.result_values import reply_values_text
from bcapscope.tui.app import BcapApp
from bcapscope.tui.controller_access.history_record import HistoryRecord, RecordOutcome, failure_text

_MAX_TEXT = 300


class CallNotice:
    def __init__(self, app: BcapApp) -> None:
        self._app = app

    def show_pending(self) -> None:
        """Show nothing: the message appears when the call ends."""

    def show_record(self, record: HistoryRecord) -> None:
        name = printable(call_name(record.function_id, record.arguments))
        if record.outcome is RecordOutcome.ANSWERED and record.reply is not None:
            text = f"{name}: {hresult_name(record.reply.code)} {reply_values_text(record.reply)}"
            self._app.show_message(text[:_MAX_TEXT])
        else:
            self._app.show_message(f"{name}: {failure_text(record)}", "error")

    def show_error(self, reason: str) -> None:
        self._app.show_message(reason[:_MAX_TEXT], "error")
