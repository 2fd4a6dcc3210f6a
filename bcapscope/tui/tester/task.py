"""The Task tab: add a task, start and stop it, read its state; RobSlave by one key."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.widgets import Button, Select

from bcapscope.protocol.enumerations import TASK_START_MODES, TASK_STOP_MODES
from bcapscope.protocol.functions import FUNCTIONS, ObjectClass
from bcapscope.protocol.variant import EMPTY, VT, Variant
from bcapscope.traffic.opened import Opened
from bcapscope.tui.tester.command import CommandForm
from bcapscope.tui.tester.field import Caption
from bcapscope.tui.tester.messages import CallWanted, RobSlaveWanted
from bcapscope.tui.tester.opener import Opener
from bcapscope.tui.tester.result import ResultView
from bcapscope.tui.words import say, told

_EXECUTE, _START, _STOP = 87, 88, 89
_NO_OPTION = Variant(VT.BSTR, "")


class TaskPanel(VerticalScroll, can_focus=False):
    """What can be done with a task: that which has the name in the field."""

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._open: tuple[Opened, ...] = ()

    def compose(self) -> ComposeResult:
        """Put the name above what can be done."""
        result = ResultView(id="task-result")
        with Vertical(classes="box", id="task-box"):
            yield Opener(ObjectClass.CONTROLLER, ObjectClass.TASK, "RobSlave", ["RobSlave"], result)
            with Horizontal(classes="row"):
                yield Caption("tester.mode")
                yield _modes(TASK_START_MODES, "start-mode")
                yield Button(say("tester.start"), compact=True, variant="primary", id="start")
                yield Button(say("tester.robslave"), compact=True, id="robslave")
            with Horizontal(classes="row"):
                yield Caption("tester.mode")
                yield _modes(TASK_STOP_MODES, "stop-mode")
                yield Button(say("tester.stop"), compact=True, id="stop")
                yield Button(say("tester.state"), compact=True, id="state")
            yield result
        with Vertical(classes="box", id="task-execute"):
            yield CommandForm(_EXECUTE)

    def show(self, open_objects: Sequence[Opened]) -> None:
        """Take note of what is open."""
        self._open = tuple(one for one in open_objects if one.kind is ObjectClass.TASK)

    @property
    def chosen(self) -> Opened | None:
        """The open task that has the name in the field."""
        name = self.query_one(Opener).object_name.casefold()
        return next((one for one in reversed(self._open) if one.label.casefold() == name), None)

    @property
    def _result(self) -> ResultView:
        return self.query_one("#task-result", ResultView)

    @on(Button.Pressed, "#start")
    def _start(self, message: Button.Pressed) -> None:
        self._run(message, _START, (Variant(VT.I4, self._mode("start-mode")), _NO_OPTION))

    @on(Button.Pressed, "#stop")
    def _stop(self, message: Button.Pressed) -> None:
        self._run(message, _STOP, (Variant(VT.I4, self._mode("stop-mode")), _NO_OPTION))

    @on(Button.Pressed, "#state")
    def _state(self, message: Button.Pressed) -> None:
        self._run(message, _EXECUTE, (Variant(VT.BSTR, "GetStatus"), EMPTY))

    @on(Button.Pressed, "#robslave")
    def _robslave(self, message: Button.Pressed) -> None:
        message.stop()
        self.post_message(RobSlaveWanted(self._result))

    def _mode(self, name: str) -> int:
        value = self.query_one(f"#{name}", Select).value
        return value if isinstance(value, int) else 0

    def _run(self, message: Button.Pressed, function_id: int, values: tuple[Variant, ...]) -> None:
        message.stop()
        found = self.chosen
        if found is None:
            self._result.fail(say("tester.task.missing"))
        else:
            self.post_message(CallWanted(self._result, FUNCTIONS[function_id], values, found))


def _modes(modes: Mapping[int, str], name: str) -> Select[int]:
    options = [(f"{value} {told(text)}", value) for value, text in modes.items()]
    return Select(options, allow_blank=False, compact=True, id=name, classes="named")
