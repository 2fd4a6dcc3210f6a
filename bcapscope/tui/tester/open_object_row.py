"""A row with an object's name and option, Add and Release, as b-CAP Tester has it."""

from __future__ import annotations

from collections.abc import Sequence

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.suggester import SuggestFromList
from textual.widgets import Button, Input

from bcapscope.client.handle_table import ObjectHandle
from bcapscope.protocol.closing_calls import RELEASES
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.render.escape import printable
from bcapscope.tui.reader_language import label
from bcapscope.tui.tester.form_widgets import Caption, FormButton
from bcapscope.tui.tester.wanted_messages import CallWanted, OpenWanted, ResultDisplay


class OpenObjectRow(Horizontal):
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
        """Set the class of objects to open; `parent` is the class of the objects that own them."""
        super().__init__(id=id, classes="row")
        self._parent_kind = parent
        self._kind = kind
        self._initial_name = name
        self._known = list(known)
        self._result_display = result_display
        self._open_objects: tuple[ObjectHandle, ...] = ()

    def compose(self) -> ComposeResult:
        yield Caption("tester.name")
        yield Input(
            self._initial_name, suggester=SuggestFromList(self._known, case_sensitive=False), classes="name"
        )
        yield Caption("tester.option")
        yield Input(classes="option")
        yield FormButton("tester.add", "primary", classes="add")
        yield FormButton("tester.release", classes="release")

    @property
    def object_name(self) -> str:
        return self.query_one(".name", Input).value.strip()

    def set_open_objects(self, open_objects: Sequence[ObjectHandle]) -> None:
        self._open_objects = tuple(each for each in open_objects if each.kind is self._kind)

    def find_open(self, owner: ObjectClass | None = None) -> ObjectHandle | None:
        """Return the latest open object with the name in the field; `owner` limits the class of its owner."""
        name = self.object_name.casefold()
        for each in reversed(self._open_objects):
            is_owned = owner is None or (each.parent is not None and each.parent.kind is owner)
            if is_owned and each.label.casefold() == name:
                return each
        return None

    @on(Button.Pressed, ".add")
    @on(Input.Submitted)
    def _add(self) -> None:
        if not self.object_name:
            self._result_display.show_error(label("tester.name.missing"))
            return
        option = self.query_one(".option", Input).value
        self.post_message(
            OpenWanted(self._result_display, self._parent_kind, self._kind, self.object_name, option)
        )

    @on(Button.Pressed, ".release")
    def _release(self) -> None:
        found = self.find_open()
        if found is None:
            text = label("tester.release.missing", name=printable(self.object_name))
            self._result_display.show_error(text)
        else:
            self.post_message(CallWanted(self._result_display, RELEASES[self._kind], (), found))
