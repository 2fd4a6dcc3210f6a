"""A widget for a value of any b-CAP type."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.message import Message
from textual.widgets import Input, Select

from bcapscope.protocol.codec.variant import ARRAY, VT, Variant, vt_name
from bcapscope.protocol.codec.variant_notation import parse_variant
from bcapscope.protocol.tables.command_catalogue import CommandSpec
from bcapscope.render.value_text import type_word
from bcapscope.tui.reader_language import full_error_text, label, table_text

PARAMETER_TYPES: tuple[int, ...] = (
    *(int(vt) for vt in VT if vt is not VT.VARIANT),
    *(ARRAY | vt for vt in VT if vt not in (VT.EMPTY, VT.NULL)),
)
"""Every type that b-CAP can carry, scalar types first."""


def type_label(vt: int) -> str:
    """Return the name of a type as in b-CAP Tester: ``I4``, ``ARRAY | R4``."""
    name = vt_name(vt & ~ARRAY).removeprefix("VT_")
    return f"ARRAY | {name}" if vt & ARRAY else name


_BY_NAME = {vt_name(vt): vt for vt in PARAMETER_TYPES}


def type_numbers(names: Iterable[str]) -> tuple[int, ...]:
    """Return the numbers of types such as ``VT_R4|VT_ARRAY``; skip ``VARIANT``, which allows any type."""
    return tuple(_BY_NAME[name] for name in names if name in _BY_NAME)


def check_text(vt: int, text: str) -> Variant | str:
    """Return `text` as a value of type `vt`, or an error text that says which input is expected."""
    typed = text if vt == VT.BSTR else text.strip()
    try:
        return parse_variant(f"{type_word(vt)}:{typed}")
    except ValueError as error:
        return f"{full_error_text(error)}; {expected_input(vt)}"


def expected_input(vt: int) -> str:
    if vt in (VT.EMPTY, VT.NULL):
        return label("controller.expected.nothing")
    what = label(f"controller.expected.{VT(vt & ~ARRAY).name}")
    several = vt & ARRAY and vt != ARRAY | VT.VARIANT
    return label("controller.expected.several" if several else "controller.expected", what=what)


def command_hint(known: CommandSpec) -> str:
    parts = [table_text(known.text)]
    if known.elements:
        parts.append(label("controller.command.parameter", elements=table_text(known.elements)))
    if known.returns:
        parts.append(label("controller.command.returns", returns=table_text(known.returns)))
    if known.in_slave_mode is False:
        parts.append(label("controller.command.refused"))
    if known.controllers:
        parts.append(table_text(known.controllers))
    return "; ".join(parts)


class TypedValue(Horizontal):
    """A list of types, and an input field that checks whether the text fits the chosen type."""

    @dataclass
    class Changed(Message):
        """`problem` says what is wrong with the text; "" for a valid or empty text."""

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
        """Whether the chosen type needs a value, but the field is empty."""
        vt, text = self.typed
        return not text and vt not in (VT.EMPTY, VT.NULL, VT.BSTR)

    @property
    def checked_value(self) -> Variant | str:
        """The value, or a text that says why the field is invalid."""
        return check_text(*self.typed)

    def select_type(self, vt: int) -> None:
        if vt in self._types:
            self.query_one(Select).value = int(vt)

    def fill_value(self, vt: int, text: str) -> None:
        self.select_type(vt)
        self.query_one(Input).value = text

    @property
    def hint(self) -> str:
        return "" if self.vt in (VT.EMPTY, VT.NULL) else expected_input(self.vt)

    @on(Input.Changed)
    @on(Select.Changed)
    def _check_input(self) -> None:
        checked = self.checked_value if self.query_one(Input).value else ""
        problem = checked if isinstance(checked, str) else ""
        self.query_one(Input).set_class(bool(problem), "-invalid")
        if self.has_focus_within:
            self.post_message(self.Changed(self, problem))

    @on(Input.Submitted)
    def _submit(self) -> None:
        self.post_message(self.Submitted())
