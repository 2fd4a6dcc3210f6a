"""Numbers as text: exact, and with no more digits than that takes."""

from __future__ import annotations

import struct
from datetime import datetime, timedelta
from decimal import Decimal

import orjson

from bcapscope.protocol.codec.variant import CY_SCALE

_DATE_ZERO = datetime(1899, 12, 30)
_SINGLE = struct.Struct("<f")


def date_text(days: float) -> str:
    """Write a DATE as date and time; empty where no calendar has one.

    Days since 1899-12-30 00:00. Before that OLE and DENSO's Python client count the fraction in opposite
    directions, so only the number itself is certain there. The time zone is the sender's secret: C and
    Python send UTC, C# local time (orin_bcap).
    """
    if not 0 <= days < 2_958_466:
        return ""
    return str((_DATE_ZERO + timedelta(days=days)).replace(microsecond=0))


def currency_text(raw: int) -> str:
    """Write a CY in the unit that COM gives it."""
    return str(Decimal(raw) / CY_SCALE)


def number_text(value: int | float) -> str:
    """Write a number with the fewest digits that read back as the same."""
    text = orjson.dumps(value).decode("ascii")
    return repr(value) if text == "null" else text


def numbers_text(values: tuple[int | float, ...]) -> str:
    """Write several numbers as `number_text` does, commas between."""
    text = orjson.dumps(values)
    return ",".join(map(number_text, values)) if b"null" in text else text[1:-1].decode("ascii")


def singles_text(values: tuple[float, ...]) -> str:
    """Write several R4 as `single_text` does, fast where seven digits are enough for each."""
    form = struct.Struct(f"<{len(values)}f")
    short = tuple(map(float, ("%.7g " * len(values) % values).split()))
    return (
        numbers_text(short) if form.pack(*short) == form.pack(*values) else ",".join(map(single_text, values))
    )


def single_text(value: float) -> str:
    """Write an R4 with digits that give the same R4 again: seven, or more where it takes them."""
    texts = (f"{value:.{digits}g}" for digits in (7, 8))
    same = (text for text in texts if _SINGLE.pack(float(text)) == _SINGLE.pack(value))
    return number_text(float(next(same, f"{value:.9g}")))
