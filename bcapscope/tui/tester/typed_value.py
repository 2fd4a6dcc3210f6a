"""Input of a value of any b-CAP type: a list of types, and a field whose text is checked at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.message import Message
from textual.widgets import Input, Select

from bcapscope.protocol.codec.variant import VT
from bcapscope.tui.controller_access.parameter_input import (
    PARAMETER_TYPES,
    CheckedText,
    check_text,
    expected_input,
    type_label,
)


class TypedValue(Horizontal):
    """A list of types and a field; reports a text that does not fit the chosen type."""

    @dataclass
    class Changed(Message):
        """The user changed type or text; `problem` says what is wrong, or is "" for valid or empty text."""

        value: TypedValue
        problem: str

    class Submitted(Message):
        """The user pressed Enter in the value's field."""

    def __init__(
        self, vt: int = VT.EMPTY, types: Sequence[int] = PARAMETER_TYPES, *, id: str | None = None
    ) -> None:
        super().__init__(id=id)
        self._types = types
        self._initial_type = int(vt)

    def compose(self) -> ComposeResult:
        options = [(type_label(vt), vt) for vt in self._types]
        select = Select(options, value=self._initial_type, allow_blank=False, compact=True, classes="type")
        select.can_focus = len(options) > 1  # otherwise there is no choice
        yield select
        yield Input(classes="value")

    @property
    def vt(self) -> int:
        value = self.query_one(Select).value
        return value if isinstance(value, int) else self._initial_type

    @property
    def typed(self) -> tuple[int, str]:
        return self.vt, self.query_one(Input).value

    @property
    def is_missing(self) -> bool:
        """Whether the chosen type needs a value and the field is empty."""
        vt, text = self.typed
        return not text and vt not in (VT.EMPTY, VT.NULL, VT.BSTR)

    @property
    def checked_text(self) -> CheckedText:
        return check_text(self.vt, self.query_one(Input).value)

    def select_type(self, vt: int) -> None:
        if vt in self._types:
            self.query_one(Select).value = int(vt)

    def fill_value(self, vt: int, text: str) -> None:
        self.select_type(vt)
        self.query_one(Input).value = text

    @property
    def hint(self) -> str:
        """Hint on what to type; "" for a type without a value."""
        return "" if self.vt in (VT.EMPTY, VT.NULL) else expected_input(self.vt)

    @on(Input.Changed)
    @on(Select.Changed)
    def _check_input(self) -> None:
        problem = self.checked_text.problem if self.query_one(Input).value else ""
        self.query_one(Input).set_class(bool(problem), "-invalid")
        if self.has_focus_within:
            self.post_message(self.Changed(self, problem))

    @on(Input.Submitted)
    def _submit(self) -> None:
        self.post_message(self.Submitted())
