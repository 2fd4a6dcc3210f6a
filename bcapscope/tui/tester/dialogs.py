"""Dialogs: questions with a few buttons, and recovery after an error, step by step."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from typing import ClassVar

from textual import on, work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.screen import ModalScreen
from textual.widgets import Button, Input, Static

from bcapscope.errors import BcapError
from bcapscope.live.controller.controller_session import ControllerSession, NotArmedError
from bcapscope.live.controller.error_recovery import RecoveryStep, read_current_errors, run_recovery_step
from bcapscope.live.controller.history_record import RecordOutcome
from bcapscope.protocol.number_parsing import parse_integer
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.render.escape import printable
from bcapscope.render.result_advice import result_advice
from bcapscope.tui.controller_access.call_history import error_text, failure_text
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label, reader_words
from bcapscope.tui.tester.call_steps import run_armed
from bcapscope.tui.tester.form_widgets import Caption, FormButton
from bcapscope.tui.widgets.text_widgets import InkedText


class ChoiceDialog(ModalScreen[str | None]):
    """Asks the user to choose. The first choice must change nothing, because it has the focus at first."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "dismiss(None)", "shell.close", key_display="esc"),
        Binding("left", "app.focus_previous", show=False),
        Binding("right", "app.focus_next", show=False),
    ]
    LABELS = "tester.answer"  # the label of a choice has the id "<LABELS>.<choice>"

    def __init__(self, lines: Sequence[str], choices: Sequence[str]) -> None:
        """`lines` are escaped lines of text: facts, then the question."""
        super().__init__()
        self._lines, self._choices = lines, choices

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog -warning"):
            yield Static("\n".join(self._lines), markup=False, id="facts")
            with Horizontal(classes="answers"):
                for at, choice in enumerate(self._choices):
                    yield FormButton(f"{self.LABELS}.{choice}", "error" if at else "default", id=choice)

    @on(Button.Pressed)
    def _answer(self, message: Button.Pressed) -> None:
        self.dismiss(message.button.id)


class ArmDialog(ChoiceDialog):
    """Asks the user to arm. `facts` are lines that say which robot could move."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("n", "dismiss(None)", show=False)]
    LABELS = "tester.arm"

    def __init__(self, facts: Sequence[str]) -> None:
        super().__init__([*facts, "", label("tester.arm.warning")], ("no", "yes"))

    def on_mount(self) -> None:
        self.query_one(".dialog").border_title = label("tester.arm.title")


_STEP_MARKS = {None: "○", True: "●", False: "✗"}


class RecoveryDialog(ModalScreen[None]):
    """Shows the steps of a recovery. The first step reads the errors that a later step clears."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape", "dismiss", "shell.close", key_display="esc")]

    def __init__(
        self,
        session: ControllerSession,
        ask_to_arm: Callable[[], Awaitable[bool]],
        first_position: str,
        mode: int,
    ) -> None:
        super().__init__()
        self._session = session
        self._ask_to_arm = ask_to_arm
        self._initial_position, self._initial_mode = first_position, mode
        self._results: dict[RecoveryStep, tuple[bool, str]] = {}

    def compose(self) -> ComposeResult:
        with Vertical(classes="dialog") as box:
            box.border_title = label("tester.recovery")
            yield InkedText(id="errors")
            for each in list(RecoveryStep)[1:]:
                with Horizontal(classes="row"):
                    yield FormButton(f"tester.recovery.{each}", id=f"do-{each}", classes="step")
                    yield InkedText(id=f"done-{each}", classes="done")
            with Horizontal(classes="row"):
                yield Caption("tester.recovery.position")
                yield Input(self._initial_position, placeholder="@E J(0,0,90,0,90,0)", id="first")
                yield Caption("tester.mode")
                yield Input(f"0x{self._initial_mode:03X}", id="mode", classes="number")

    def on_mount(self) -> None:
        self.query_one("#do-clear").focus()
        self._show_step(RecoveryStep.READ, None, label("tester.waiting"))
        self._read_errors()

    @work(group="recovery")
    async def _read_errors(self) -> None:
        try:
            errors = await self._session.run_in_loop(read_current_errors(self._session))
        except (BcapError, OSError) as error:
            self._show_step(RecoveryStep.READ, False, error_text(error))
            return
        lines = [label("tester.recovery.none")] if not errors else []
        for code, text in errors:
            lines.append(f"{INK.bad}{hresult_name(code)}{INK.reset} {printable(text)}")
            lines += [f"  {line}" for line in list(result_advice(code, INK, reader_words()))[1:]]
        self._results[RecoveryStep.READ] = (True, "")
        self.query_one("#errors", InkedText).show_text("\n".join(lines))

    @on(Button.Pressed)
    @work(group="recovery")
    async def _run_step(self, message: Button.Pressed) -> None:
        step_wanted = RecoveryStep((message.button.id or "").removeprefix("do-"))
        first, text = self.query_one("#first", Input).value, self.query_one("#mode", Input).value
        mode = parse_integer(text, -(1 << 31), (1 << 31) - 1)
        if mode is None:
            self._show_step(step_wanted, False, label("tester.recovery.number"))
            return
        self._show_step(step_wanted, None, label("tester.waiting"))
        try:
            record = await run_armed(
                self._session,
                self._ask_to_arm,
                lambda session: run_recovery_step(session, step_wanted, first, mode),
            )
        except NotArmedError:
            self._show_step(step_wanted, False, label("tester.not_armed"))
        except (BcapError, OSError) as error:
            self._show_step(step_wanted, False, error_text(error))
        else:
            done = record.outcome is RecordOutcome.ANSWERED
            self._show_step(step_wanted, done, "" if done else failure_text(record))
            following = list(RecoveryStep)[list(RecoveryStep).index(step_wanted) + 1 :]
            if done and following:
                self.query_one(f"#do-{following[0]}").focus()

    def _show_step(self, which: RecoveryStep, done: bool | None, text: str) -> None:
        color = {None: INK.number, True: INK.good, False: INK.bad}[done]
        name = "#errors" if which is RecoveryStep.READ else f"#done-{which}"
        self.query_one(name, InkedText).show_text(f"{color}{_STEP_MARKS[done]} {printable(text)}{INK.reset}")
