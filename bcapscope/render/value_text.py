"""Write values of VARIANTs as text, for fields, for replies, and in the notation of `variant_notation`."""

from __future__ import annotations

from bcapscope.errors import LocalProtocolError
from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import ARRAY, VT, Value, Variant, encode_variant
from bcapscope.protocol.codec.variant_notation import parse_variant
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.protocol.text_format import shortened
from bcapscope.render.escape import printable, quoted
from bcapscope.render.number import currency_text, date_text, number_text, single_text

LONGEST_STRING = 60  # default maximum number of characters of a string

MAX_ELEMENTS = 512  # maximum number of elements of an array in a reply's value

LONGEST_REPLY_STRING = 4000  # maximum number of characters of a string in a reply's value

_DECIMALS = 5  # b-CAP Tester shows 5 decimals (DENSO Wave 2009, How to use the Slave mode)
_EMPTY = "(EMPTY)"


def value_text(
    value: Value, vt: int, longest: int | None = LONGEST_STRING, words: MessageFormatter = ENGLISH_WORDS
) -> str:
    """Return a scalar value as text; "" for other values. Cut a string after `longest` characters."""
    if isinstance(value, str):
        return _string_text(value, longest, words)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return _float_text(value, vt)
    if not isinstance(value, int):
        return ""
    if vt == VT.CY:
        return f"{value}, {words('field.currency', value=currency_text(value))}"
    return f"{value} {hresult_name(value)}" if vt == VT.ERROR else str(value)


def _string_text(text: str, longest: int | None, words: MessageFormatter) -> str:
    if longest is None or len(text) <= longest:
        return quoted(text)
    return f"{quoted(text[:longest])}… {words.plural('count.more-character', len(text) - longest)}"


def _float_text(value: float, vt: int) -> str:
    if vt == VT.R4:
        return single_text(value)
    date = date_text(value) if vt == VT.DATE else ""
    return f"{value!r}, {date}" if date else repr(value)


def reply_values_text(reply: Frame, full: bool = False) -> str:
    return "  ".join(variant_values_text(value, full) for value in reply.variants) or _EMPTY


def variant_values_text(variant: Variant, full: bool = False) -> str:
    """Return escaped text. Floating-point numbers have five decimals, or all digits with `full`."""
    base, value = variant.vt & ~ARRAY, variant.value
    if value is None:
        return _EMPTY
    if not isinstance(value, (bytes, tuple)):
        return _reply_scalar(base, value, full)
    shown = value[:MAX_ELEMENTS]
    more = f" … {len(value) - MAX_ELEMENTS} more" if len(value) > MAX_ELEMENTS else ""
    if isinstance(shown, bytes):
        return shown.hex(" ").upper() + more
    texts = (
        variant_values_text(each, full) if isinstance(each, Variant) else _reply_scalar(base, each, full)
        for each in shown
    )
    return f"({'; '.join(texts)}{more})" if base == VT.VARIANT else ", ".join(texts) + more


def _reply_scalar(vt: int, value: Value, full: bool) -> str:
    if isinstance(value, str):
        return printable(shortened(value, LONGEST_REPLY_STRING))
    if isinstance(value, float) and not full and vt in (VT.R4, VT.R8):
        text = f"{value:.{_DECIMALS}f}"
        return text if len(text) < 32 else f"{value:.{_DECIMALS}e}"
    return value_text(value, vt, None)


def untyped_text(variant: Variant) -> str | None:
    """Return a value as text without its type, such as ``10,20,30``.

    Return None if the notation cannot express the value. The notation cannot express nested VARIANT arrays,
    arrays of strings that contain separators, and types that b-CAP does not have.
    """
    text = _untyped_text(variant)
    return text if text is not None and _reads_back(variant, f"{type_word(variant.vt)}:{text}") else None


def typed_text(variant: Variant) -> str | None:
    """Return a type and a value, such as ``r4[]:10,20,30``; None if the notation cannot express the value."""
    text = untyped_text(variant)
    return None if text is None else f"{type_word(variant.vt)}:{text}"


def type_word(vt: int) -> str:
    base = vt & ~ARRAY
    name = VT(base).name.lower() if base in VT.__members__.values() else f"0x{base:04x}"
    return f"{name}[]" if vt & ARRAY else name


def _reads_back(variant: Variant, text: str) -> bool:
    try:
        return encode_variant(parse_variant(text)) == encode_variant(variant)
    except (ValueError, LocalProtocolError):
        return False


def _untyped_text(variant: Variant) -> str | None:
    base, value = variant.vt & ~ARRAY, variant.value
    if base == variant.vt:
        return _element_text(base, value)
    if isinstance(value, bytes):
        return ",".join(map(str, value))
    if not isinstance(value, tuple):
        return None
    texts = [typed_text(each) if isinstance(each, Variant) else _element_text(base, each) for each in value]
    separator = ";" if base == VT.VARIANT else ","
    return None if None in texts else separator.join(text or "" for text in texts)


def _element_text(vt: int, value: Value) -> str | None:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return single_text(value) if vt == VT.R4 else number_text(value)
    if isinstance(value, int):
        return str(value)
    return value if isinstance(value, str) else None
