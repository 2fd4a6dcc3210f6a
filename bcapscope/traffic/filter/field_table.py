"""Table of all fields of the filter syntax, for the compiler and for the help.

The field names are the same as in the JSON of `decode` and `calls`. The getter of a field returns a value of
the field's type, or None if the record has no such value.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum, StrEnum
from types import MappingProxyType
from typing import NamedTuple

from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.protocol.tables.hresult import CODE_BY_NAME
from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.reserved_field import ReservedConvention


class RecordKind(StrEnum):
    """Kind of record that a filter tests."""

    FRAME = "frame"
    CALL = "call"


class FieldType(Enum):
    """Type of a field's values. The value of each member is the type's name, as messages show it."""

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
        """Type of the list's elements; None if the type is no list."""
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
        type: Type of the field's values. The type determines which comparisons are permitted.
        applies_to: Kinds of record that have the field.
        meaning: Description of the field in the help.
        unit: Unit assumed for a number that is written without a unit; "" if the field has no unit.
        values: All words that the field can have as its value; () if it can have any word.
        known: Function that returns the usual values of the field; other words are also permitted.
        reads_as: Name of the field whose getter this field uses; "" if the field has its own getter.
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
"""Name of the field with the time since the first frame. `Filter.bind` makes its getter."""


def _known_commands() -> frozenset[str]:
    # Load the catalogue of commands only when a filter needs it, because loading takes 10 ms.
    from bcapscope.protocol.tables.command_catalogue import commands_of  # noqa: PLC0415

    return frozenset(command.name for id in FUNCTIONS for command in commands_of(id))


_FRAME = (RecordKind.FRAME,)
_CALL = (RecordKind.CALL,)
_BOTH = (RecordKind.FRAME, RecordKind.CALL)

FIELDS: tuple[FilterField, ...] = (
    FilterField("frame", FieldType.NUMBER, _FRAME, "number of the frame, from 1"),
    FilterField("packet", FieldType.NUMBER, _FRAME, "number of the packet that completed the frame, from 1"),
    FilterField(
        "time", FieldType.TIME, _FRAME, "time of the frame's last byte, since 1970-01-01 UTC", unit="s"
    ),
    FilterField(
        SINCE_FIRST,
        FieldType.DURATION,
        _BOTH,
        "seconds from the first frame to this frame, or to the call's first request",
        unit="s",
    ),
    FilterField("src", FieldType.ENDPOINT, _FRAME, "sender"),
    FilterField("dst", FieldType.ENDPOINT, _FRAME, "receiver"),
    FilterField(
        "kind",
        FieldType.TEXT,
        _FRAME,
        "kind of frame: request, response or malformed",
        values=("request", "response", "malformed"),
    ),
    FilterField(
        "length",
        FieldType.NUMBER,
        _FRAME,
        "length of the whole frame in bytes, from its header",
        unit="bytes",
    ),
    FilterField("serial", FieldType.NUMBER, _FRAME, "serial number"),
    FilterField(
        "reserved", FieldType.NUMBER, _FRAME, "reserved field; in a retry it names an earlier attempt"
    ),
    FilterField("problems", FieldType.TEXTS, _FRAME, "problems of the frame"),
    FilterField("call", FieldType.NUMBER, _CALL, "number of the call, from 1"),
    FilterField("client", FieldType.ENDPOINT, _BOTH, "address of the client"),
    FilterField("server", FieldType.ENDPOINT, _BOTH, "address of the controller"),
    FilterField("transport", FieldType.TEXT, _BOTH, "udp or tcp", values=("udp", "tcp")),
    FilterField(
        "function_id",
        FieldType.NUMBER,
        _BOTH,
        "number of the function that was requested or answered",
    ),
    FilterField(
        "function",
        FieldType.TEXT,
        _BOTH,
        "name of the function that was requested or answered",
        values=tuple(function.name for function in FUNCTIONS.values()),
    ),
    FilterField(
        "command",
        FieldType.TEXT,
        _BOTH,
        "command of an Execute function, such as slvMove",
        known=_known_commands,
    ),
    FilterField(
        "arg", FieldType.VALUES, _BOTH, "arguments of the frame or of the call's request; arg[0] is the first"
    ),
    FilterField("hresult", FieldType.HRESULT, _BOTH, "result code of the reply"),
    FilterField(
        "hresult_name",
        FieldType.TEXT,
        _BOTH,
        "name of the result code, such as S_OK",
        known=lambda: frozenset(CODE_BY_NAME),
    ),
    FilterField("hresult_text", FieldType.TEXT, _BOTH, "meaning of the result code"),
    FilterField(
        "started", FieldType.TIME, _CALL, "time of the call's first request, since 1970-01-01 UTC", unit="s"
    ),
    FilterField(
        "requests", FieldType.NUMBERS, _CALL, "frame numbers of the call's requests, including retries"
    ),
    FilterField("serials", FieldType.NUMBERS, _CALL, "serial numbers of the call's requests"),
    FilterField("retries", FieldType.NUMBER, _CALL, "number of captured retries"),
    FilterField(
        "unseen_retries",
        FieldType.NUMBER,
        _CALL,
        "number of retries that were not captured, inferred from skipped serials",
    ),
    FilterField("replies", FieldType.NUMBERS, _CALL, "frame numbers of the replies that the client accepted"),
    FilterField("late_replies", FieldType.NUMBERS, _CALL, "frame numbers of late replies"),
    FilterField(
        "lost_replies",
        FieldType.NUMBERS,
        _CALL,
        "frame numbers of replies that were captured in time but evidently lost",
    ),
    FilterField("executing", FieldType.NUMBER, _CALL, "number of S_EXECUTING notices"),
    FilterField(
        "duplicates", FieldType.NUMBERS, _CALL, "frame numbers of exact copies of requests and replies"
    ),
    FilterField(
        "captured_again",
        FieldType.NUMBERS,
        _CALL,
        "numbers of frames whose packet was probably captured twice",
    ),
    FilterField("outcome", FieldType.TEXT, _CALL, "how the call ended", values=tuple(Outcome)),
    FilterField("latency", FieldType.DURATION, _CALL, "time from the first request to the accepted reply"),
    FilterField(
        "latency_ms",
        FieldType.DURATION,
        _CALL,
        "like latency, but a number without a unit is in ms",
        unit="ms",
        reads_as="latency",
    ),
    FilterField(
        "rtt", FieldType.DURATION, _CALL, "time from the request that was answered to the accepted reply"
    ),
    FilterField(
        "rtt_ms",
        FieldType.DURATION,
        _CALL,
        "like rtt, but a number without a unit is in ms",
        unit="ms",
        reads_as="rtt",
    ),
    FilterField(
        "convention",
        FieldType.TEXT,
        _CALL,
        "how the client uses the reserved field",
        known=lambda: frozenset(ReservedConvention),
    ),
    FilterField(
        "verdict",
        FieldType.TEXT,
        _CALL,
        "what happened to the call, as far as the traffic shows",
        values=tuple(CallVerdict),
    ),
)
"""All fields, in the order in which the help lists them."""

FIELD_BY_NAME: Mapping[str, FilterField] = MappingProxyType({field.name: field for field in FIELDS})


def fields_of(kind: RecordKind) -> dict[str, FilterField]:
    return {field.name: field for field in FIELDS if kind in field.applies_to}
