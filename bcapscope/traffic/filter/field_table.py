"""The fields of the filter syntax (`fields.tsv`), named as in the JSON of `decode` and `calls`."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from enum import Enum, StrEnum
from types import MappingProxyType
from typing import NamedTuple

from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.protocol.tables.hresult import CODE_BY_NAME
from bcapscope.protocol.tables.table_rows import table_rows
from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.reserved_field import ReservedConvention


class RecordKind(StrEnum):
    FRAME = "frame"
    CALL = "call"


class FieldType(Enum):
    """Type of a field's values, named as in the output of `bcapscope fields`."""

    NUMBER = "number"
    """An int or a float."""
    TEXT = "text"
    """A str."""
    TIME = "time"
    """Nanoseconds since 1970-01-01 UTC."""
    DURATION = "duration"
    """Nanoseconds."""
    HRESULT = "HRESULT"
    """A 32-bit int, signed or unsigned."""
    ENDPOINT = "endpoint"
    """An `Endpoint`, or its text."""
    NUMBERS = "list of numbers"
    """A list or tuple of int."""
    TEXTS = "list of texts"
    """A list or tuple of str."""
    VALUES = "list of values"
    """A list or tuple of `Argument`, `Variant` or their plain values."""
    VALUE = "value"
    """An element of `VALUES`: a number, text, boolean, list or null, depending on the VARIANT type."""

    @property
    def element(self) -> FieldType | None:
        """Type of one element, for `VALUE` and the list types; None for all other types."""
        return _ELEMENTS.get(self)


_ELEMENTS = {
    FieldType.NUMBERS: FieldType.NUMBER,
    FieldType.TEXTS: FieldType.TEXT,
    FieldType.VALUES: FieldType.VALUE,
    FieldType.VALUE: FieldType.VALUE,
}


class FilterField(NamedTuple):
    """One field of the filter syntax.

    Attributes:
        unit: Unit assumed for a number that is written without a unit; "" if the field has no unit.
        values: All words that the field can have as its value; () if it can have any word.
        reads_as: Name of the field whose getter this field uses; "" if the field has its own getter.
        known: Function that returns the usual values of the field; other words are also permitted.
    """

    name: str
    type: FieldType
    applies_to: tuple[RecordKind, ...]
    meaning: str
    unit: str = ""
    values: tuple[str, ...] = ()
    reads_as: str = ""
    known: Callable[[], frozenset[str]] = frozenset

    @property
    def getter_name(self) -> str:
        return self.reads_as or self.name


SINCE_FIRST = "t"


def _known_commands() -> frozenset[str]:
    from bcapscope.protocol.tables.command_catalogue import commands_of  # noqa: PLC0415  # import takes 10 ms

    return frozenset(command.name for id in FUNCTIONS for command in commands_of(id))


_VALUES: dict[str, tuple[str, ...]] = {
    "kind": ("request", "response", "malformed"),
    "transport": ("udp", "tcp"),
    "function": tuple(function.name for function in FUNCTIONS.values()),
    "outcome": tuple(Outcome),
    "verdict": tuple(CallVerdict),
}
_KNOWN: dict[str, Callable[[], frozenset[str]]] = {
    "command": _known_commands,
    "hresult_name": lambda: frozenset(CODE_BY_NAME),
    "convention": lambda: frozenset(ReservedConvention),
}


def _field(row: dict[str, str]) -> FilterField:
    name = row["name"]
    return FilterField(
        name,
        FieldType(row["type"]),
        tuple(map(RecordKind, row["records"].split())),
        row["meaning"],
        row["unit"],
        _VALUES.get(name, ()),
        row["reads as"],
        _KNOWN.get(name, frozenset),
    )


FIELDS = tuple(map(_field, table_rows("fields", os.path.dirname(__file__))))

FIELD_BY_NAME: Mapping[str, FilterField] = MappingProxyType({field.name: field for field in FIELDS})


def fields_of(kind: RecordKind) -> dict[str, FilterField]:
    return {field.name: field for field in FIELDS if kind in field.applies_to}
