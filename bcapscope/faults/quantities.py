"""The values that a user writes in a fault. In each class, `read` parses a value from YAML or from the
command line, and `text` writes the value. An invalid value raises an `InputError`.
"""

from __future__ import annotations

import math
import re
from fractions import Fraction
from typing import Self

from bcapscope.errors import InputError
from bcapscope.messages import Message
from bcapscope.protocol.tables.hresult import CODE_BY_NAME, hresult_name
from bcapscope.protocol.text_format import shortened
from bcapscope.traffic.filter.compiler import Filter, compile_filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.filter.operands import UNITS
from bcapscope.traffic.filter.tokens import with_nearest

LONGEST_DURATION = 10**9 * 86_400 * 365
"""Maximum duration in ns: one year, so that sums of durations stay exact."""

LARGEST_END = 1e19
"""Largest absolute value that an end of a range can have. No integer type of b-CAP holds a larger number."""

MAX_INDEXES = 8
"""Maximum number of indexes after ``arg``. Controllers nest arrays only two levels deep."""

_LONGEST_SHOWN = 150  # bits of an integer; Python cannot convert more than about 14,000 bits to text
_NUMBER = r"[0-9]{1,18}(?:\.[0-9]{1,18})?"
_DURATION = re.compile(rf"({_NUMBER})\s*([a-zµμ]+)")
_SHARE = re.compile(rf"({_NUMBER})\s*%")
_RATE = re.compile(rf"({_NUMBER})\s*([kM]?)(bit|B)/s")
_CODE = re.compile(r"0[xX][0-9A-Fa-f]{1,8}|-?[0-9]{1,10}")
_PATH = re.compile(r"arg((?:\[[0-9]{1,5}\])+)")
_SPAN = re.compile(r"([-+0-9.eE]*?)\.\.([-+0-9.eE]*)")
_MULTIPLES = {"": 1, "k": 1000, "M": 1_000_000}
_FOLDED_CODES = {name.casefold(): code for name, code in CODE_BY_NAME.items()}


class DurationQuantity(int):
    """A duration in ns. Users write it with a unit: ``3ms``, ``1.5 s``, ``200us``."""

    @classmethod
    def read(cls, written: object) -> Self:
        if written == 0 and not isinstance(written, bool):
            return cls(0)
        match = _DURATION.fullmatch(written.strip()) if isinstance(written, str) else None
        if match is None or match[2] not in UNITS:
            raise _invalid("duration", written)
        value = round(Fraction(match[1]) * UNITS[match[2]])
        if value > LONGEST_DURATION:
            raise _invalid("duration.long", written)
        return cls(value)

    @property
    def text(self) -> str:
        unit = next(unit for unit in ("s", "ms", "us", "ns") if self % UNITS[unit] == 0)
        return f"{self // UNITS[unit]}{unit}"


class Share(float):
    """A share or probability, 0 to 1. Users write it as ``5%`` or ``0.05``."""

    @classmethod
    def read(cls, written: object) -> Self:
        match = _SHARE.fullmatch(written.strip()) if isinstance(written, str) else None
        value: float
        if match:
            value = float(Fraction(match[1]) / 100)
        elif isinstance(written, int | float) and not isinstance(written, bool):
            value = written
        else:
            raise _invalid("share", written)
        # This check comes before the conversion, because a float cannot hold every integer.
        if not 0 <= value <= 1:
            raise _invalid("share.outside", written)
        return cls(value)

    @property
    def text(self) -> str:
        return f"{self * 100:.15f}".rstrip("0").rstrip(".") + "%"


class Rate(float):
    """A bandwidth in bytes per second, which users write as ``64kbit/s`` or ``8kB/s``."""

    @classmethod
    def read(cls, written: object) -> Self:
        match = _RATE.fullmatch(written.strip()) if isinstance(written, str) else None
        if match is None:
            raise _invalid("rate", written)
        value = Fraction(match[1]) * _MULTIPLES[match[2]] / (8 if match[3] == "bit" else 1)
        if value < 1:
            raise _invalid("rate.low", written)
        return cls(float(value))

    @property
    def text(self) -> str:
        for letter, multiple in (("M", 1_000_000), ("k", 1000)):
            if self * 8 % multiple == 0:
                return f"{self * 8 / multiple:.15g}{letter}bit/s"
        return f"{self * 8:.15g}bit/s"


class HresultQuantity(int):
    """An unsigned HRESULT. Users write an HRESULT as a name, a signed number or an unsigned number."""

    @classmethod
    def read(cls, written: object) -> Self:
        if isinstance(written, str):
            known = _FOLDED_CODES.get(written.strip().casefold())
            if known is not None:
                return cls(known)
            if not _CODE.fullmatch(written.strip()):
                unknown = _invalid("code.unknown", written)
                raise InputError(with_nearest(unknown.message, written, CODE_BY_NAME))
            written = int(written, 16) if "x" in written.lower() else int(written)
        if not isinstance(written, int) or isinstance(written, bool) or not -(2**31) <= written < 2**32:
            raise _invalid("code", written)
        return cls(written & 0xFFFFFFFF)

    @property
    def text(self) -> str:
        name = hresult_name(self)
        return name if CODE_BY_NAME.get(name) == self else f"0x{self:08X}"


class FrameCondition:
    """A filter for requests and replies, which can also test the command that a reply answers."""

    __slots__ = ("filter",)

    def __init__(self, compiled: Filter) -> None:
        self.filter = compiled

    @classmethod
    def read(cls, written: object) -> Self:
        """Compile the expression of a filter. An invalid expression raises a `FilterError`."""
        if isinstance(written, bool):  # YAML reads the filters `true` and `false` as booleans
            written = str(written).lower()
        if not isinstance(written, str):
            raise _invalid("condition", written)
        return cls(compile_filter(written, RecordKind.FRAME))

    @property
    def text(self) -> str:
        return self.filter.expression

    def __eq__(self, other: object) -> bool:
        return isinstance(other, FrameCondition) and self.text == other.text

    def __hash__(self) -> int:
        return hash(self.text)


class Span:
    """A range of numbers. Users write ``-90..90``, ``..90`` or ``0..``. A missing end is infinite."""

    __slots__ = ("high", "low")

    def __init__(self, low: float, high: float) -> None:
        self.low = low
        self.high = high

    @classmethod
    def read(cls, written: object) -> Self:
        match = _SPAN.fullmatch(written.strip()) if isinstance(written, str) else None
        try:
            if match is None or not (match[1] or match[2]):
                raise ValueError
            low = float(match[1]) if match[1] else -math.inf
            high = float(match[2]) if match[2] else math.inf
        except ValueError:
            raise _invalid("span", written) from None
        if any(match[each] and not abs(end) <= LARGEST_END for each, end in ((1, low), (2, high))):
            raise _invalid("span.far", written, limit=f"{LARGEST_END:g}")
        if low > high:
            raise _invalid("span.empty", written)
        return cls(low, high)

    @property
    def text(self) -> str:
        low, high = (
            repr(limit).removesuffix(".0") if math.isfinite(limit) else "" for limit in (self.low, self.high)
        )
        return f"{low}..{high}"

    def clamp(self, number: float) -> float:
        """Return the number, moved to the nearest end of the range if needed. NaN becomes a finite end."""
        if math.isnan(number):
            return self.low if math.isfinite(self.low) else self.high
        return min(max(number, self.low), self.high)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Span) and (self.low, self.high) == (other.low, other.high)

    def __hash__(self) -> int:
        return hash((self.low, self.high))


QUANTITIES = (DurationQuantity, Share, Rate, HresultQuantity, FrameCondition, Span)


def read_path(written: str) -> tuple[int, ...]:
    """Return the indexes in the name of an argument or element, such as (2, 0) for ``arg[2][0]``. Any other
    text raises an `InputError`.
    """
    match = _PATH.fullmatch(written)
    indexes = tuple(map(int, re.findall("[0-9]+", match[1]))) if match else ()
    if not 1 <= len(indexes) <= MAX_INDEXES:
        raise _invalid("argument", written)
    return indexes


def _invalid(what: str, written: object, **places: str) -> InputError:
    return InputError(Message(f"quantity.{what}", text=_shown(written), **places))


def _shown(written: object) -> str | Message:
    if isinstance(written, int) and written.bit_length() > _LONGEST_SHOWN:
        return Message("quantity.bits", bits=written.bit_length())
    return shortened(repr(written), 60)
