"""Describe the fields of a frame as text."""

from __future__ import annotations

from itertools import islice

from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.protocol.codec.variant import VT, Value, vt_name
from bcapscope.protocol.dissection.frame_field import HRESULT, FrameField
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.render.escape import quoted
from bcapscope.render.number import currency_text, date_text, single_text

LONGEST_STRING = 60
"""By default, the text of a string shows at most this many characters."""


def value_text(
    value: Value, vt: int, longest: int | None = LONGEST_STRING, words: MessageFormatter = ENGLISH_WORDS
) -> str:
    """Return a scalar value as text. Return "" for a missing value, bytes or an array.

    A string is cut after `longest` characters.
    """
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


def field_meaning(
    field: FrameField, longest: int | None = LONGEST_STRING, words: MessageFormatter = ENGLISH_WORDS
) -> str:
    """Return the meaning of a field in one line, or "" if the name of the field says everything.

    A string is cut after `longest` characters.
    """
    text = (
        _variant_meaning(field, longest, words)
        if field.vt is not None
        else _frame_field_meaning(field, words)
    )
    if field.unit:
        text += f" {field.unit}"
    return f"{text}, {words.place_text(field.text, '')}" if field.text and field.vt is not None else text


def _frame_field_meaning(field: FrameField, words: MessageFormatter) -> str:
    """Describe a field of the frame that is not part of a VARIANT."""
    value = field.value
    if isinstance(value, bytes):
        return words.plural("count.byte", len(value)) + (f", {field.text}" if field.text else "")
    if field.name == "type" or value is None:
        return str(field.text)
    if field.name == HRESULT and isinstance(value, int):
        return f"{field.text}, {words.text(describe_hresult(value).meaning)}"
    return f"{value} {field.text}".rstrip()


def _variant_meaning(field: FrameField, longest: int | None, words: MessageFormatter) -> str:
    """Describe the value of a VARIANT. Add the type of the VARIANT if the field includes the bytes of the
    type."""
    value, vt = field.value, field.vt or 0
    text = value_text(value, vt, longest, words)
    if isinstance(value, tuple):
        text = words.plural("count.element", len(value))
    elif isinstance(value, bytes):
        text = words.plural("count.byte", len(value))
    if field.name == "data" and isinstance(value, str):
        return ""  # its characters come next
    has_type = any(child.name == "type" for child in islice(field.children, 2))
    return f"{vt_name(vt)} {text}".rstrip() if has_type else text
