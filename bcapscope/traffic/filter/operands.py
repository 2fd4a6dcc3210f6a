"""Compile the right side of a comparison: turn its tokens into a test for the field's type.

Every function raises a `FilterError` if the field cannot be compared with the token.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from typing import NamedTuple, NoReturn

from bcapscope.protocol.tables.hresult_table import NAMED_CODES
from bcapscope.traffic.filter import matching as matches
from bcapscope.traffic.filter.field_table import FieldType, FilterField
from bcapscope.traffic.filter.matching import LiteralMatch, Match, Number
from bcapscope.traffic.filter.tokens import FilterError, Token, TokenKind, nearest

UNITS = {"ns": 1, "us": 10**3, "µs": 10**3, "μs": 10**3, "ms": 10**6, "s": 10**9}
"""Nanoseconds per unit. The prefix micro can be written as u, as the micro sign or as the Greek letter."""

NUMERIC = frozenset({FieldType.NUMBER, FieldType.TIME, FieldType.DURATION})

_LISTS = frozenset({FieldType.NUMBERS, FieldType.TEXTS, FieldType.VALUES})
_LITERALS = frozenset({TokenKind.WORD, TokenKind.NUMBER, TokenKind.TEXT, TokenKind.ADDRESS})
_RESERVED = ("and", "or", "not", "in", "contains", "matches")
_CODES = {entry.name: entry.code for entry in NAMED_CODES if entry.name}
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_TIMESTAMP = re.compile(
    r"(\d{4}-\d\d-\d\d)(?:[T ](\d\d:\d\d(?::\d\d)?)(?:\.(\d{1,9}))?)?(Z|[+-]\d\d:\d\d)?", re.ASCII
)


class ComparedField(NamedTuple):
    """The left side of a comparison: what the compiler of the right side needs to know about it.

    Attributes:
        expression: The whole filter expression, for error messages.
        field: Field at the start of the left side, without indexes.
        type: Type of the values of the left side: the field's type, or the type of an element.
        start: Index in the expression of the first character of the left side.
    """

    expression: str
    field: FilterField
    name: str
    type: FieldType
    start: int

    @property
    def name_and_type(self) -> str:
        type_ = self.type.value
        return f"{self.name} is {'an' if type_[0] in 'aeioH' else 'a'} {type_}"

    def fail(self, reason: str) -> NoReturn:
        self.fail_at(self.start, reason)

    def fail_at(self, place: Token | int, reason: str) -> NoReturn:
        raise FilterError(self.expression, place if isinstance(place, int) else place.start, reason)


def equality(compared: ComparedField, literals: Sequence[Token], negated: bool) -> Match:
    """Compile ``==``, ``!=``, ``in`` and ``not in``."""
    return matches.equality([_literal_match(compared, literal) for literal in literals], negated)


def order(compared: ComparedField, sign: str, literal: Token) -> Match:
    """Compile ``<``, ``<=``, ``>`` and ``>=``."""
    check_literal(compared, literal)
    if compared.type is FieldType.HRESULT:
        signed = literal.kind is TokenKind.NUMBER and not _is_hex(literal) and int_of(literal) < 2**31
        return matches.code_order(sign, _code(compared, literal), signed)
    if compared.type in NUMERIC or compared.type is FieldType.VALUE:
        return matches.order(sign, _number(compared, literal))
    compared.fail(f"{compared.name_and_type}, which has no order")


def contains(compared: ComparedField, literal: Token) -> Match:
    """Compile ``contains``."""
    check_literal(compared, literal)
    if compared.type in NUMERIC or compared.type is FieldType.HRESULT:
        compared.fail(f"{compared.name_and_type}; contains works only on texts and lists")
    if compared.type is FieldType.NUMBERS or (
        literal.kind is TokenKind.NUMBER and compared.type in (FieldType.VALUE, FieldType.VALUES)
    ):
        _check_number(compared, literal)
        return matches.contains(_plain_number(compared, literal))
    if literal.is_word("true", "false", "null"):
        compared.fail_at(literal, "contains takes a text or a number")
    if literal.kind is TokenKind.NUMBER:
        compared.fail_at(literal, f"{compared.name_and_type}: put what it contains in quotes")
    return matches.contains(literal.text)


def search(compared: ComparedField, literal: Token) -> Match:
    """Compile ``~``."""
    if compared.type in NUMERIC or compared.type in (FieldType.HRESULT, FieldType.NUMBERS):
        compared.fail(f"{compared.name_and_type}; a regular expression needs a text")
    check_literal(compared, literal)
    if literal.kind not in (TokenKind.TEXT, TokenKind.WORD):
        compared.fail_at(literal, "write a regular expression in quotes")
    try:
        return matches.search(literal.text)
    except ValueError as error:
        reason, part = error.args
        found = compared.expression.find(part, literal.start, literal.stop) if part else -1
        position = literal.start if found < 0 else found
        raise FilterError(compared.expression, position, f"in the regular expression: {reason}") from error


def check_literal(compared: ComparedField, token: Token) -> None:
    """Check that a token is a literal value.

    Raises:
        FilterError: The token is a sign, a reserved word, or the end of the expression.
    """
    if token.kind is TokenKind.END:
        compared.fail_at(token, f"a value to compare {compared.name} with is missing")
    if token.kind not in _LITERALS:
        compared.fail_at(token, f"expected a value, not {token.text!r}")
    if token.is_word(*_RESERVED):
        compared.fail_at(token, f"expected a value; if {token.text!r} is one, put it in quotes")


def int_of(token: Token) -> int:
    """Return the integer part of a decimal or hexadecimal number token."""
    return int(token.text, 16) if _is_hex(token) else math.trunc(Fraction(token.text))


def _is_hex(token: Token) -> bool:
    return "x" in token.text.casefold()


def _literal_match(compared: ComparedField, token: Token) -> LiteralMatch:
    check_literal(compared, token)
    if token.is_word("null"):
        return matches.NULL
    if compared.type in _LISTS:
        compared.fail_at(
            token, f"{compared.name_and_type}: use {compared.name} contains ..., or {compared.name}[0]"
        )
    match compared.type:
        case FieldType.HRESULT:
            return matches.code(_code(compared, token))
        case FieldType.ENDPOINT:
            return _endpoint(compared, token)
        case FieldType.TEXT:
            return matches.text(_text(compared, token))
        case FieldType.VALUE:
            return _value(compared, token)
    return matches.number(_number(compared, token))


def _value(compared: ComparedField, token: Token) -> LiteralMatch:
    if token.kind is TokenKind.NUMBER:
        return matches.number(_number(compared, token))
    if token.is_word("true", "false"):
        return matches.boolean(token.is_word("true"))
    return matches.text(token.text)


def _text(compared: ComparedField, token: Token) -> str:
    if token.kind is TokenKind.NUMBER:
        hint = "; the number is function_id" if compared.field.name == "function" else ""
        compared.fail_at(token, f"{compared.name_and_type}, not a number{hint}")
    values = compared.field.values
    if values and token.kind is TokenKind.WORD and token.text.casefold() not in map(str.casefold, values):
        hint = nearest(token.text, values)
        some = "" if hint or len(values) > 5 else f"; it is one of {', '.join(values)}"
        compared.fail_at(token, f"{compared.name} is never {token.text}{hint}{some}")
    return token.text


def _endpoint(compared: ComparedField, token: Token) -> LiteralMatch:
    found = matches.parse_endpoint(token.text) if token.kind in (TokenKind.ADDRESS, TokenKind.TEXT) else None
    if found is None:
        compared.fail_at(
            token, f"{token.text!r} is no IP address; write 10.0.0.2, 10.0.0.2:5007 or [::1]:5007"
        )
    return matches.endpoint(*found)


def _number(compared: ComparedField, token: Token) -> Number:
    if compared.type is FieldType.TIME and token.kind is TokenKind.TEXT:
        return _timestamp(compared, token)
    _check_number(compared, token)
    if compared.type in (FieldType.TIME, FieldType.DURATION):
        return _nanoseconds(compared, token)
    return _plain_number(compared, token)


def _check_number(compared: ComparedField, token: Token) -> None:
    if token.kind is not TokenKind.NUMBER:
        compared.fail_at(token, f"{compared.name_and_type}, but {token.text!r} is not")


def _plain_number(compared: ComparedField, token: Token) -> int | float:
    if token.unit:
        position = token.start + len(token.text)
        compared.fail_at(position, f"{compared.name} is no time, {token.unit!r} means nothing here")
    if _is_hex(token) or token.text.lstrip("+-").isdecimal():
        return int_of(token)
    value = float(token.text)
    if math.isinf(value):
        compared.fail_at(token, "this number is too large")
    return value


def _nanoseconds(compared: ComparedField, token: Token) -> Number:
    value = Fraction(int_of(token)) if _is_hex(token) else Fraction(token.text)
    unit = token.unit or compared.field.unit
    if not unit and value:
        compared.fail_at(token, f"{compared.name} needs a unit: {token.text}ms, or us, ns, s")
    if unit and unit not in UNITS:
        compared.fail_at(token.start + len(token.text), f"{unit!r} is no unit; use ns, us, ms or s")
    value *= UNITS[unit] if unit else 1
    return value.numerator if value.denominator == 1 else value


def _timestamp(compared: ComparedField, token: Token) -> int:
    match = _TIMESTAMP.fullmatch(token.text)
    if match is None:
        compared.fail_at(token, f"{token.text!r} is no time such as '2024-05-01 12:00:00.5'")
    day, clock, fraction, zone = match.groups()
    try:
        moment = datetime.fromisoformat(f"{day}T{clock or '00:00'}{zone or 'Z'}")
    except ValueError as error:
        raise FilterError(compared.expression, token.start, f"{token.text!r} is no time: {error}") from error
    return (moment - _EPOCH) // timedelta(seconds=1) * 10**9 + int((fraction or "").ljust(9, "0"))


def _code(compared: ComparedField, token: Token) -> int:
    if token.kind in (TokenKind.WORD, TokenKind.TEXT):
        code = _CODES.get(token.text.upper())
        if code is None:
            compared.fail_at(token, f"no HRESULT is called {token.text!r}{nearest(token.text, _CODES)}")
        return code
    if token.unit:
        compared.fail_at(token, f"write a hexadecimal code as 0x{token.text}{token.unit}")
    if not (_is_hex(token) or token.text.lstrip("+-").isdecimal()):
        compared.fail_at(token, f"{compared.name} is a whole number, or a name such as S_OK")
    value = int_of(token)
    if not -(2**31) <= value < 2**32:
        compared.fail_at(token, "an HRESULT has 32 bits")
    return value
