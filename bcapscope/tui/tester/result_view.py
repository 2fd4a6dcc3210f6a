"""Show the result of a call, a problem with its remedy, or a hint on the input."""

from __future__ import annotations

from typing import ClassVar

from textual.binding import Binding, BindingType

from bcapscope.live.controller.history_record import HistoryRecord, RecordOutcome
from bcapscope.protocol.tables.command_catalogue import command_name
from bcapscope.protocol.tables.enumerations import result_meanings
from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.protocol.tables.hresult import E_FAIL, S_OK, describe_hresult, hresult_name
from bcapscope.render.escape import printable
from bcapscope.render.result_advice import result_advice
from bcapscope.render.value_text import reply_values_text
from bcapscope.tui.controller_access.call_history import failure_text
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label, reader_words, table_text
from bcapscope.tui.widgets.text_widgets import InkedText


class ResultView(InkedText, can_focus=True):
    """Shows one result with five decimals, as b-CAP Tester does; the key ``d`` shows all digits."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("d", "digits", "tester.digits")]
    record: HistoryRecord | None = None
    shows_all_digits = False
    text = ""  # shown result, problem or hint, with ink marks (see `bcapscope.tui.ink`)

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id, classes="-empty")

    def show_record(self, record: HistoryRecord) -> None:
        self.record = record
        self._show_line(_record_text(record, self.shows_all_digits))
        self._scroll_into_view()

    def show_pending(self) -> None:
        self._show_text(label("tester.waiting"), INK.dim)

    def show_error(self, reason: str) -> None:
        self._show_text(reason, INK.bad)
        self._scroll_into_view()

    def show_problem(self, text: str) -> None:
        self._show_text(text, INK.problem)

    def _show_text(self, text: str, ink: str) -> None:
        self.record = None
        self._show_line(f"{ink}{printable(text)}{INK.reset}" if text else "")

    def show_check(self, problem: str, hint: str) -> None:
        self._show_text(problem or hint, INK.problem if problem else INK.dim)

    def action_digits(self) -> None:
        self.show_digits(not self.shows_all_digits)

    def show_digits(self, full: bool) -> None:
        self.shows_all_digits = full
        if self.record is not None:
            self.show_record(self.record)

    def _scroll_into_view(self) -> None:
        """Scroll the forms until this view is visible, because a small terminal shows only a few forms."""
        self.call_after_refresh(self.scroll_visible, animate=False)

    def _show_line(self, line: str) -> None:
        self.text = line
        self.set_class(not line, "-empty")
        head = f"{INK.name}{label('tester.result')}{INK.reset}  " if self.record is not None else ""
        self.show_text(head + line)


def _record_text(record: HistoryRecord, full: bool) -> str:
    took = f"  {INK.dim}{record.took / 1e6:.3f} ms{INK.reset}"
    if record.outcome is RecordOutcome.ANSWERED and record.reply is not None:
        code = record.reply.code
        name = "" if code == S_OK else f"  {INK.good}{hresult_name(code)}{INK.reset}"
        meaning = _value_meaning(record)
        words = f"  {INK.name}{meaning}{INK.reset}" if meaning else ""
        return f"{INK.number}{reply_values_text(record.reply, full)}{INK.reset}{words}{name}{took}"
    if record.outcome is RecordOutcome.REFUSED and record.reply is not None:
        first, *rest = result_advice(record.reply.code, INK, reader_words())
        if _may_lack_robslave(record):
            rest.append(label("tester.robslave.needed"))
        return "\n".join([first + took, *rest])
    return f"{INK.bad}{failure_text(record)}{INK.reset}{took}"


def _may_lack_robslave(record: HistoryRecord) -> bool:
    """Return whether the controller refused slave mode without a reason. An RC7 needs the program RobSlave
    for slave mode (DENSO Wave 2009, How to use the Slave mode); the error without RobSlave is not documented.
    """
    code = record.reply.code if record.reply is not None else S_OK
    command = command_name(record.function_id, record.arguments) or ""
    return command.casefold() == "slvchangemode" and (code == E_FAIL or not describe_hresult(code).is_listed)


def _value_meaning(record: HistoryRecord) -> str:
    arguments = record.reply.arguments if record.reply is not None else ()
    value = arguments[0].variant.value if arguments else None
    function = FUNCTIONS.get(record.function_id)
    if function is not None and function.creates is not None and arguments:
        return label("field.handle", object=function.creates.value)
    command = command_name(record.function_id, record.arguments) or ""
    meanings = result_meanings(record.function_id, command, value) if isinstance(value, int) else ()
    return label("list.comma").join(table_text(each) for each in meanings)
