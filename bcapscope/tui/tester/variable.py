"""Variables: Name, Option, Value; Add, Release, Get, Put, and Watch."""

from __future__ import annotations

from collections.abc import Sequence

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.widgets import Button

from bcapscope.protocol.functions import FUNCTIONS, ObjectClass
from bcapscope.protocol.variables import VARIABLES, variable
from bcapscope.protocol.variant import VT
from bcapscope.traffic.opened import Opened
from bcapscope.tui.desk.parameter import expected, type_of
from bcapscope.tui.tester.field import Caption
from bcapscope.tui.tester.messages import CallWanted, WatchWanted
from bcapscope.tui.tester.opener import Opener
from bcapscope.tui.tester.result import ResultView
from bcapscope.tui.tester.typed import TypedValue
from bcapscope.tui.words import say

_GET, _PUT = 101, 102


class VariablePanel(Vertical):
    """Variables of the controller, of the robot or of a task: that which has the name in the field."""

    def __init__(self, owner: ObjectClass, name: str, *, id: str | None = None) -> None:
        """Take whose variables they are, and a name to begin with."""
        super().__init__(id=id, classes="box")
        self._owner = owner
        self._first = name
        self._open: tuple[Opened, ...] = ()

    def compose(self) -> ComposeResult:
        """Put the name above the value."""
        result = ResultView()
        known = [
            f"{each.name}1" if each.numbered else each.name for each in VARIABLES if each.owner is self._owner
        ]
        yield Opener(self._owner, ObjectClass.VARIABLE, self._first, known, result)
        with Horizontal(classes="row"):
            yield Caption("tester.value")
            yield TypedValue(VT.I4)
            yield Button(say("tester.get"), compact=True, variant="primary", classes="get")
            yield Button(say("tester.put"), compact=True, classes="put")
            yield Button(say("tester.watch"), compact=True, classes="watch")
        yield result

    def show(self, open_objects: Sequence[Opened]) -> None:
        """Take note of what is open."""
        self._open = tuple(
            one
            for one in open_objects
            if one.kind is ObjectClass.VARIABLE and one.parent is not None and one.parent.kind is self._owner
        )

    @property
    def chosen(self) -> Opened | None:
        """The open variable that has the name in the field; the latest of several."""
        name = self.query_one(Opener).object_name.casefold()
        return next((one for one in reversed(self._open) if one.label.casefold() == name), None)

    @on(TypedValue.Changed)
    def _check(self, message: TypedValue.Changed) -> None:
        message.stop()
        result = self.query_one(ResultView)
        if message.problem:
            result.problem(message.problem)
        else:
            result.hint(expected(message.value.vt))

    @on(Button.Pressed, ".get")
    def _get(self, message: Button.Pressed) -> None:
        message.stop()
        found = self._needed()
        if found is not None:
            self.post_message(CallWanted(self.query_one(ResultView), FUNCTIONS[_GET], (), found))

    @on(Button.Pressed, ".put")
    @on(TypedValue.Submitted)
    def _put(self, message: Button.Pressed | TypedValue.Submitted) -> None:
        message.stop()
        found, checked = self._needed(), self.query_one(TypedValue).checked
        if found is None:
            return
        if checked.value is None:
            self.query_one(ResultView).problem(checked.problem)
            return
        self.post_message(CallWanted(self.query_one(ResultView), FUNCTIONS[_PUT], (checked.value,), found))

    @on(Button.Pressed, ".watch")
    def _watch(self, message: Button.Pressed) -> None:
        message.stop()
        found = self._needed()
        if found is not None:
            self.post_message(WatchWanted(found, True))

    def opened(self, owner: ObjectClass, name: str) -> None:
        """Choose the type of a variable that was just opened, if it is one of ours and its type is known."""
        if owner is not self._owner:
            return
        known = variable(self._owner, name)
        types = [vt for each in known.types if (vt := type_of(each)) is not None] if known else []
        if types:
            with self.prevent(TypedValue.Changed):
                self.query_one(TypedValue).choose(types[0])

    def _needed(self) -> Opened | None:
        found = self.chosen
        if found is None:
            self.query_one(ResultView).fail(say("tester.variable.missing"))
        return found
