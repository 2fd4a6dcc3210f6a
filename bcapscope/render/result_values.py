"""Write the values of a reply as text. Numbers have five decimals, as in DENSO's b-CAP Tester, or all
digits."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import ARRAY, VT, Value, Variant
from bcapscope.render.escape import printable
from bcapscope.render.field_meaning import value_text

DECIMALS = 5
"""Number of decimals that DENSO's b-CAP Tester shows (DENSO Wave 2009, How to use the Slave mode)."""

MAX_ELEMENTS = 512
"""The text of an array shows at most this many elements."""

LONGEST_STRING = 4000
"""The text of a string shows at most this many characters."""

EMPTY_TEXT = "(EMPTY)"


def reply_values_text(reply: Frame, full: bool = False) -> str:
    """Return the values of a reply as text, or ``(EMPTY)`` if the reply has no values."""
    return "  ".join(variant_values_text(value, full) for value in reply.variants) or EMPTY_TEXT


def variant_values_text(variant: Variant, full: bool = False) -> str:
    """Return a value as escaped text. Floating-point numbers have five decimals, or all digits with
    `full`."""
    vt, value = variant.vt, variant.value
    if value is None:
        return EMPTY_TEXT
    if isinstance(value, bytes):
        more = f" … {len(value) - MAX_ELEMENTS} more" if len(value) > MAX_ELEMENTS else ""
        return value[:MAX_ELEMENTS].hex(" ").upper() + more
    if not isinstance(value, tuple):
        return _scalar(vt, value, full)
    shown = value[:MAX_ELEMENTS]
    more = f" … {len(value) - MAX_ELEMENTS} more" if len(value) > MAX_ELEMENTS else ""
    if vt & ~ARRAY == VT.VARIANT:
        return f"({'; '.join(_items(shown, full))}{more})"
    return ", ".join(_scalar(vt & ~ARRAY, each, full) for each in _values(shown)) + more


def _items(items: Iterable[object], full: bool) -> Iterable[str]:
    return (variant_values_text(item, full) for item in items if isinstance(item, Variant))


def _values(items: Sequence[Value | Variant]) -> Iterable[Value]:
    return (item for item in items if not isinstance(item, Variant))


def _scalar(vt: int, value: Value, full: bool) -> str:
    if isinstance(value, str):
        return printable(value[:LONGEST_STRING]) + ("…" if len(value) > LONGEST_STRING else "")
    if isinstance(value, float) and not full and vt in (VT.R4, VT.R8):
        text = f"{value:.{DECIMALS}f}"
        return text if len(text) < 32 else f"{value:.{DECIMALS}e}"
    return value_text(value, vt, None)
