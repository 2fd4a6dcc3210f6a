"""What became of a call: its result, or what is wrong and what to do, or what is expected."""

from __future__ import annotations

from typing import ClassVar

from textual.binding import Binding, BindingType

from bcapscope.protocol.commands import command_name
from bcapscope.protocol.enumerations import stands_for
from bcapscope.protocol.functions import FUNCTIONS
from bcapscope.protocol.hresult import E_FAIL, S_OK, describe, hresult_name
from bcapscope.render.advice import advice
from bcapscope.render.escape import printable
from bcapscope.render.result import reply_result
from bcapscope.tui.desk.record import Ending, Record, why
from bcapscope.tui.ink import INK
from bcapscope.tui.widgets.inked import InkedText
from bcapscope.tui.words import say, told


class ResultView(InkedText, can_focus=True):
    """Shows one result, five decimals as b-CAP Tester does; ``d`` shows all digits.

    Attributes:
        full: all digits are shown.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("d", "digits", "tester.digits", id="result.digits", tooltip="tester.digits.tip"),
    ]

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id, classes="-empty")
        self._record: Record | None = None
        self.full = False
        self._line = ""

    @property
    def text(self) -> str:
        """What is shown, with the marks of its colours."""
        return self._line

    @property
    def record(self) -> Record | None:
        """The call that is shown; None where there is none, or something else is shown."""
        return self._record

    def begin(self) -> None:
        """Show that the call is under way."""
        self._record = None
        self._write(f"{INK.dim}{say('tester.waiting')}{INK.reset}")

    def take(self, record: Record) -> None:
        """Show how a call ended."""
        self._record = record
        self._write(_record_text(record, self.full))
        self._come_into_sight()

    def fail(self, reason: str) -> None:
        """Show why nothing was sent, or what broke."""
        self._record = None
        self._write(f"{INK.bad}{printable(reason)}{INK.reset}")
        self._come_into_sight()

    def hint(self, text: str) -> None:
        """Show what is expected."""
        self._record = None
        self._write(f"{INK.dim}{printable(text)}{INK.reset}" if text else "")

    def problem(self, text: str) -> None:
        """Show what is wrong with what was typed."""
        self._record = None
        self._write(f"{INK.problem}{printable(text)}{INK.reset}")

    def action_digits(self) -> None:
        """Show all digits, or five behind the point again."""
        self.show_digits(not self.full)

    def show_digits(self, full: bool) -> None:
        """Show all digits, or five behind the point."""
        self.full = full
        if self._record is not None:
            self.take(self._record)

    def _come_into_sight(self) -> None:
        """Scroll what holds the forms, where the screen is too low for all of them."""
        self.call_after_refresh(self.scroll_visible, animate=False)

    def _write(self, line: str) -> None:
        if line == self._line:
            return
        self._line = line
        self.set_class(not line, "-empty")
        head = f"{INK.name}{say('tester.result')}{INK.reset}  " if self._record is not None else ""
        self.write(head + line)


def _record_text(record: Record, full: bool) -> str:
    took = f"  {INK.dim}{record.took / 1e6:.3f} ms{INK.reset}"
    if record.ending is Ending.ANSWERED and record.reply is not None:
        code = record.reply.code
        name = "" if code == S_OK else f"  {INK.good}{hresult_name(code)}{INK.reset}"
        meaning = _meaning(record)
        words = f"  {INK.name}{meaning}{INK.reset}" if meaning else ""
        return f"{INK.number}{reply_result(record.reply, full)}{INK.reset}{words}{name}{took}"
    if record.ending is Ending.REFUSED and record.reply is not None:
        first, *rest = advice(record.reply.code, INK, told)
        if _may_lack_robslave(record):
            rest.append(say("tester.robslave.needed"))
        return "\n".join([first + took, *rest])
    return f"{INK.bad}{why(record)}{INK.reset}{took}"


def _may_lack_robslave(record: Record) -> bool:
    """Tell whether slave mode is refused without a reason, as on an RC7 that does not run RobSlave.

    It needs that program (DENSO Wave 2009, How to use the Slave mode); what it answers without it is not
    documented.
    """
    code = record.reply.code if record.reply is not None else S_OK
    asked = command_name(record.function_id, record.arguments).casefold() == "slvchangemode"
    return asked and (code == E_FAIL or not describe(code).known)


def _meaning(record: Record) -> str:
    """Tell what a number that came back stands for; "" where it is but a number."""
    arguments = record.reply.arguments if record.reply is not None else ()
    value = arguments[0].variant.value if arguments else None
    function = FUNCTIONS.get(record.function_id)
    if function is not None and function.creates is not None and arguments:
        return told(f"handle of a {function.creates}")
    command = command_name(record.function_id, record.arguments)
    words = stands_for(record.function_id, command, value) if isinstance(value, int) else ()
    return ", ".join(map(told, words))
