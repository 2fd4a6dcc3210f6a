"""Write numbers as exact text with the fewest possible digits."""

from __future__ import annotations

import struct
from datetime import datetime, timedelta
from decimal import Decimal

import orjson

from bcapscope.protocol.codec.variant import CY_SCALE

_DATE_ZERO = datetime(1899, 12, 30)
_SINGLE = struct.Struct("<f")


def date_text(days: float) -> str:
    """Return a DATE (days since 1899-12-30 00:00) as date and time, or "" if the DATE is negative or after
    year 9999.

    OLE and DENSO's Python client interpret the fraction of a negative DATE differently. The time zone of a
    DATE is unknown: DENSO's C and Python clients send UTC, the C# client sends local time (orin_bcap).
    """
    if not 0 <= days < 2_958_466:
        return ""
    return str((_DATE_ZERO + timedelta(days=days)).replace(microsecond=0))


def currency_text(raw: int) -> str:
    return str(Decimal(raw) / CY_SCALE)


def number_text(value: int | float) -> str:
    """Return a number as text, with the fewest digits that give the same number when parsed."""
    text = orjson.dumps(value).decode("ascii")
    return repr(value) if text == "null" else text


def numbers_text(values: tuple[int | float, ...]) -> str:
    text = orjson.dumps(values)
    return ",".join(map(number_text, values)) if b"null" in text else text[1:-1].decode("ascii")


def singles_text(values: tuple[float, ...]) -> str:
    """Write R4 values as `single_text` does, separated by commas. If seven digits suffice for all values,
    this function does not call `single_text` for each value, but writes all values together.
    """
    form = struct.Struct(f"<{len(values)}f")
    short = tuple(map(float, ("%.7g " * len(values) % values).split()))
    return (
        numbers_text(short) if form.pack(*short) == form.pack(*values) else ",".join(map(single_text, values))
    )


def single_text(value: float) -> str:
    """Write an R4 value with the fewest digits, from seven to nine, that give the same value when parsed."""
    texts = (f"{value:.{digits}g}" for digits in (7, 8))
    same = (text for text in texts if _SINGLE.pack(float(text)) == _SINGLE.pack(value))
    return number_text(float(next(same, f"{value:.9g}")))
