"""Name and option of an object, Add and Release, as b-CAP Tester has them for robots, variables and tasks."""

from __future__ import annotations

from collections.abc import Sequence

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.suggester import SuggestFromList
from textual.widgets import Button, Input

from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.tui.tester.caption import Caption
from bcapscope.tui.tester.wanted_messages import OpenWanted, ResultDisplay
from bcapscope.tui.words import say


class OpenObjectRow(Horizontal):
    """A row that opens objects of one class."""

    class ReleaseWanted(OpenWanted):
        """Release the object that has this name."""

    def __init__(
        self,
        parent: ObjectClass,
        kind: ObjectClass,
        name: str,
        known: Sequence[str],
        result_display: ResultDisplay,
        *,
        id: str | None = None,
    ) -> None:
        """Take what is opened of what.

        Args:
            parent: class of the object that it is asked of.
            kind: what is opened.
            name: what stands in the field at first.
            known: names that complete what is typed.
            result_display: shows what becomes of it.
            id: of the widget.
        """
        super().__init__(id=id, classes="row")
        self._parent_kind = parent
        self._kind = kind
        self._initial_name = name
        self._known = list(known)
        self._result_display = result_display

    def compose(self) -> ComposeResult:
        """Put all into one row."""
        yield Caption("tester.name")
        yield Input(
            self._initial_name, suggester=SuggestFromList(self._known, case_sensitive=False), classes="name"
        )
        yield Caption("tester.option")
        yield Input(classes="option")
        yield Button(say("tester.add"), compact=True, variant="primary", classes="add")
        yield Button(say("tester.release"), compact=True, classes="release")

    @property
    def object_name(self) -> str:
        """What stands in the field."""
        return self.query_one(".name", Input).value.strip()

    def _make_message(self, kind: type[OpenWanted]) -> OpenWanted:
        option = self.query_one(".option", Input).value
        return kind(self._result_display, self._parent_kind, self._kind, self.object_name, option)

    @on(Button.Pressed, ".add")
    @on(Input.Submitted)
    def _add(self, message: Button.Pressed | Input.Submitted) -> None:
        message.stop()
        if not self.object_name:
            self._result_display.show_error(say("tester.name.missing"))
            return
        self.post_message(self._make_message(OpenWanted))

    @on(Button.Pressed, ".release")
    def _release(self, message: Button.Pressed) -> None:
        message.stop()
        self.post_message(self._make_message(self.ReleaseWanted))
