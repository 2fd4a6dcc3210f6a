"""The way out of an error, one step after the other: read, clear, RobSlave, first position, slave mode."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.screen import ModalScreen
from textual.widgets import Button, Input

from bcapscope.errors import BcapError
from bcapscope.protocol.hresult import hresult_name
from bcapscope.protocol.numerals import read_integer
from bcapscope.render.advice import advice
from bcapscope.render.escape import printable
from bcapscope.tui.desk.desk import Desk, NotArmedError
from bcapscope.tui.desk.record import Ending, Record, cause, why
from bcapscope.tui.desk.recovery import Step, read_errors, step
from bcapscope.tui.ink import INK
from bcapscope.tui.tester.field import Caption
from bcapscope.tui.widgets.inked import InkedText
from bcapscope.tui.words import say, told

_MARKS = {None: "○", True: "●", False: "✗"}


class RecoveryDialog(ModalScreen[None]):
    """Shows the steps; the errors are read at once, everything else is done when the user says so."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "dismiss", "shell.close", key_display="esc"),
    ]

    def __init__(self, desk: Desk, arm: Callable[[], Awaitable[bool]], first: str, mode: int) -> None:
        """Take the desk, what asks to arm, and what is known of the first position and the mode."""
        super().__init__()
        self._desk, self._arm, self._first, self._mode = desk, arm, first, mode
        self._done: dict[Step, tuple[bool, str]] = {}

    def compose(self) -> ComposeResult:
        """Put the steps below the errors."""
        with Vertical(classes="dialog") as box:
            box.border_title = say("tester.recovery")
            yield InkedText(id="errors")
            for each in list(Step)[1:]:
                with Horizontal(classes="row"):
                    yield Button(
                        say(f"tester.recovery.{each}"), compact=True, id=f"do-{each}", classes="step"
                    )
                    yield InkedText(id=f"done-{each}", classes="done")
            with Horizontal(classes="row"):
                yield Caption("tester.recovery.position")
                yield Input(self._first, placeholder="@E J(0,0,90,0,90,0)", id="first")
                yield Caption("tester.mode")
                yield Input(f"0x{self._mode:03X}", id="mode", classes="number")

    def on_mount(self) -> None:
        """Read the errors, before anything clears them."""
        self.query_one("#do-clear").focus()
        self._mark(Step.READ, None, say("tester.waiting"))
        self.run_worker(self._read(), group="recovery")

    async def _read(self) -> None:
        try:
            errors = await self._desk.do(read_errors(self._desk))
        except (BcapError, OSError) as error:
            self._mark(Step.READ, False, cause(error))
            return
        lines = [say("tester.recovery.none")] if not errors else []
        for code, text in errors:
            lines.append(f"{INK.bad}{hresult_name(code)}{INK.reset} {printable(told(text))}")
            lines += [f"  {line}" for line in list(advice(code, INK, told))[1:]]
        self._done[Step.READ] = (True, "")
        self.query_one("#errors", InkedText).write("\n".join(lines))

    @on(Button.Pressed)
    def _pressed(self, message: Button.Pressed) -> None:
        message.stop()
        which = Step((message.button.id or "").removeprefix("do-"))
        self.run_worker(self._do(which), group="recovery")

    async def _do(self, which: Step) -> None:
        first, text = self.query_one("#first", Input).value, self.query_one("#mode", Input).value
        mode = read_integer(text, -(1 << 31), (1 << 31) - 1)
        if mode is None:
            self._mark(which, False, say("tester.recovery.number"))
            return
        self._mark(which, None, say("tester.waiting"))
        try:
            record = await self._armed(which, first, mode)
        except NotArmedError:
            self._mark(which, False, say("tester.not_armed"))
        except (BcapError, OSError) as error:
            self._mark(which, False, cause(error))
        else:
            done = record.ending is Ending.ANSWERED
            self._mark(which, done, "" if done else why(record))
            if done:
                self._go_on(which)

    async def _armed(self, which: Step, first: str, mode: int) -> Record:
        try:
            return await self._desk.do(step(self._desk, which, first, mode))
        except NotArmedError:
            if not await self._arm():
                raise
        return await self._desk.do(step(self._desk, which, first, mode))

    def _go_on(self, which: Step) -> None:
        """Put the focus on the next step."""
        steps = list(Step)
        at = steps.index(which) + 1
        if at < len(steps):
            self.query_one(f"#do-{steps[at]}").focus()

    def _mark(self, which: Step, done: bool | None, text: str) -> None:
        color = {None: INK.number, True: INK.good, False: INK.bad}[done]
        name = "#errors" if which is Step.READ else f"#done-{which}"
        self.query_one(name, InkedText).write(f"{color}{_MARKS[done]} {printable(text)}{INK.reset}")
