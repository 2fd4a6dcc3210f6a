"""Write VARIANTs in the notation that `protocol.codec.variant_notation` parses."""

from __future__ import annotations

from bcapscope.errors import LocalProtocolError
from bcapscope.protocol.codec.variant import ARRAY, VT, Value, Variant, encode_variant
from bcapscope.protocol.codec.variant_notation import parse_variant
from bcapscope.render.number import number_text, single_text


def untyped_text(variant: Variant) -> str | None:
    """Return a value in the notation without its type. To parse the result, a program must know the type.

    The result is None if the notation cannot express the value. The notation cannot express a VARIANT array
    inside a VARIANT array, an array of strings if a string contains a separator, or a type that b-CAP does
    not have.
    """
    text = _untyped_text(variant)
    return text if text is not None and _reads_back(variant, f"{type_word(variant.vt)}:{text}") else None


def typed_text(variant: Variant) -> str | None:
    """Return a value in the notation with its type, such as ``r4[]:10,20,30``. Return None if the notation
    cannot express the value.
    """
    text = untyped_text(variant)
    return None if text is None else f"{type_word(variant.vt)}:{text}"


def type_word(vt: int) -> str:
    """Return the name of a type in the notation, such as ``i4`` or ``r4[]``."""
    base = vt & ~ARRAY
    name = VT(base).name.lower() if base in VT.__members__.values() else f"0x{base:04x}"
    return f"{name}[]" if vt & ARRAY else name


def _reads_back(variant: Variant, text: str) -> bool:
    try:
        return encode_variant(parse_variant(text)) == encode_variant(variant)
    except (ValueError, LocalProtocolError):
        return False


def _untyped_text(variant: Variant) -> str | None:
    vt, value = variant.vt, variant.value
    if vt & ARRAY == 0:
        return _element_text(vt, value)
    if isinstance(value, bytes):
        return ",".join(map(str, value))
    if not isinstance(value, tuple):
        return None
    if vt & ~ARRAY == VT.VARIANT:
        items = [typed_text(item) for item in value if isinstance(item, Variant)]
        return ";".join(item or "" for item in items) if None not in items else None
    texts = [_element_text(vt & ~ARRAY, item) for item in value if not isinstance(item, Variant)]
    return ",".join(text or "" for text in texts) if None not in texts else None


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
