"""What stands on the right of a comparison: tokens made into what a field's type can be compared with.

This is where an expression is checked against the types of the fields.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from typing import NamedTuple, NoReturn

from bcapscope.protocol.hresult_table import SYMBOLS
from bcapscope.traffic import filter_matches as matches
from bcapscope.traffic.fields import Field, FieldType
from bcapscope.traffic.filter_matches import Match, Number, Wanted
from bcapscope.traffic.filter_tokens import FilterError, Token, TokenKind, nearest

UNITS = {"ns": 1, "us": 10**3, "µs": 10**3, "μs": 10**3, "ms": 10**6, "s": 10**9}
"""Nanoseconds in each; micro is written as u, as the micro sign or as the Greek letter."""

NUMERIC = frozenset({FieldType.NUMBER, FieldType.TIME, FieldType.DURATION})

_LISTS = frozenset({FieldType.NUMBERS, FieldType.TEXTS, FieldType.VALUES})
_LITERALS = frozenset({TokenKind.WORD, TokenKind.NUMBER, TokenKind.TEXT, TokenKind.ADDRESS})
_RESERVED = ("and", "or", "not", "in", "contains", "matches")
_CODES = {entry.name: entry.code for entry in SYMBOLS if entry.name}
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MOMENT = re.compile(
    r"(\d{4}-\d\d-\d\d)(?:[T ](\d\d:\d\d(?::\d\d)?)(?:\.(\d{1,9}))?)?(Z|[+-]\d\d:\d\d)?", re.ASCII
)


class Subject(NamedTuple):
    """The left side of a comparison, as far as its right side must know it.

    Attributes:
        expression: the whole filter, for error messages.
        field: the field it begins with.
        name: the field with its indexes, as written.
        type: the type of its values: the field's, or that of an element.
        start: index of its first character in the expression.
    """

    expression: str
    field: Field
    name: str
    type: FieldType
    start: int

    def refuse(self, token: Token, reason: str) -> NoReturn:
        """Raise a `FilterError` that points at `token`."""
        raise FilterError(self.expression, token.start, reason)


def equality(subject: Subject, literals: Sequence[Token], negated: bool) -> Match:
    """Compile ``==``, ``!=``, ``in`` and ``not in``.

    Raises:
        FilterError: a literal is none that the subject can be compared with.
    """
    return matches.equality([_wanted(subject, literal) for literal in literals], negated)


def order(subject: Subject, sign: str, literal: Token) -> Match:
    """Compile ``<``, ``<=``, ``>`` and ``>=``.

    Raises:
        FilterError: the subject has no order, or the literal is no number that it can be compared with.
    """
    check_literal(subject, literal)
    if subject.type is FieldType.HRESULT:
        signed = literal.kind is TokenKind.NUMBER and not _is_hex(literal) and int_of(literal) < 2**31
        return matches.code_order(sign, _code(subject, literal), signed)
    if subject.type in NUMERIC or subject.type is FieldType.VALUE:
        return matches.order(sign, _number(subject, literal))
    raise FilterError(
        subject.expression, subject.start, f"{subject.name} is {_a(subject.type)}, which has no order"
    )


def contains(subject: Subject, literal: Token) -> Match:
    """Compile ``contains``.

    Raises:
        FilterError: the subject has nothing in it that could be contained, or not such a thing.
    """
    check_literal(subject, literal)
    if subject.type in NUMERIC or subject.type is FieldType.HRESULT:
        raise FilterError(
            subject.expression, subject.start, f"{subject.name} is {_a(subject.type)}, it contains nothing"
        )
    if subject.type is FieldType.NUMBERS or (
        literal.kind is TokenKind.NUMBER and subject.type in (FieldType.VALUE, FieldType.VALUES)
    ):
        _check_number(subject, literal)
        return matches.contains(_plain_number(subject, literal))
    if literal.is_word("true", "false", "null"):
        subject.refuse(literal, "contains takes a text or a number")
    if literal.kind is TokenKind.NUMBER:
        subject.refuse(literal, f"{subject.name} is {_a(subject.type)}: put what it contains in quotes")
    return matches.contains(literal.text)


def search(subject: Subject, literal: Token) -> Match:
    """Compile ``~``.

    Raises:
        FilterError: the subject is no text, or the literal no regular expression that RE2 takes.
    """
    if subject.type in NUMERIC or subject.type in (FieldType.HRESULT, FieldType.NUMBERS):
        raise FilterError(
            subject.expression,
            subject.start,
            f"{subject.name} is {_a(subject.type)}, a regular expression needs text",
        )
    check_literal(subject, literal)
    if literal.kind not in (TokenKind.TEXT, TokenKind.WORD):
        subject.refuse(literal, "a regular expression stands in quotes")
    try:
        return matches.search(literal.text)
    except ValueError as error:
        reason, part = error.args
        found = subject.expression.find(part, literal.start, literal.stop) if part else -1
        position = literal.start if found < 0 else found
        raise FilterError(subject.expression, position, f"in the regular expression: {reason}") from error


def check_literal(subject: Subject, token: Token) -> None:
    """Make sure that `token` is a value at all.

    Raises:
        FilterError: it is a sign, a word of the language, or the end.
    """
    if token.kind is TokenKind.END:
        subject.refuse(token, f"a value to compare {subject.name} with is missing")
    if token.kind not in _LITERALS:
        subject.refuse(token, f"expected a value, not {token.text!r}")
    if token.is_word(*_RESERVED):
        subject.refuse(token, f"expected a value; if {token.text!r} is one, put it in quotes")


def int_of(token: Token) -> int:
    """Read the integer part of a number; hexadecimal digits as well."""
    return int(token.text, 16) if _is_hex(token) else math.trunc(Fraction(token.text))


def _is_hex(token: Token) -> bool:
    return "x" in token.text.casefold()


def _a(type_: FieldType) -> str:
    return f"{'an' if type_.value[0] in 'aeioH' else 'a'} {type_.value}"


def _wanted(subject: Subject, token: Token) -> Wanted:
    check_literal(subject, token)
    if token.is_word("null"):
        return matches.NULL
    if subject.type in _LISTS:
        subject.refuse(
            token,
            f"{subject.name} is {_a(subject.type)}: use {subject.name} contains ..., or {subject.name}[0]",
        )
    match subject.type:
        case FieldType.HRESULT:
            return matches.code(_code(subject, token))
        case FieldType.ENDPOINT:
            return _endpoint(subject, token)
        case FieldType.TEXT:
            return matches.text(_text(subject, token))
        case FieldType.VALUE:
            return _value(subject, token)
    return matches.number(_number(subject, token))


def _value(subject: Subject, token: Token) -> Wanted:
    if token.kind is TokenKind.NUMBER:
        return matches.number(_number(subject, token))
    if token.is_word("true", "false"):
        return matches.boolean(token.is_word("true"))
    return matches.text(token.text)


def _text(subject: Subject, token: Token) -> str:
    if token.kind is TokenKind.NUMBER:
        hint = "; the number is function_id" if subject.field.name == "function" else ""
        subject.refuse(token, f"{subject.name} is {_a(subject.type)}, not a number{hint}")
    values = subject.field.values
    if values and token.kind is TokenKind.WORD and token.text.casefold() not in map(str.casefold, values):
        hint = nearest(token.text, values)
        some = "" if hint or len(values) > 5 else f"; it is one of {', '.join(values)}"
        subject.refuse(token, f"{subject.name} is never {token.text}{hint}{some}")
    return token.text


def _endpoint(subject: Subject, token: Token) -> Wanted:
    found = matches.parse_endpoint(token.text) if token.kind in (TokenKind.ADDRESS, TokenKind.TEXT) else None
    if found is None:
        subject.refuse(
            token, f"{token.text!r} is no IP address; 10.0.0.2, 10.0.0.2:5007 or [::1]:5007 would be"
        )
    return matches.endpoint(*found)


def _number(subject: Subject, token: Token) -> Number:
    if subject.type is FieldType.TIME and token.kind is TokenKind.TEXT:
        return _moment(subject, token)
    _check_number(subject, token)
    if subject.type in (FieldType.TIME, FieldType.DURATION):
        return _nanoseconds(subject, token)
    return _plain_number(subject, token)


def _check_number(subject: Subject, token: Token) -> None:
    if token.kind is not TokenKind.NUMBER:
        subject.refuse(token, f"{subject.name} is {_a(subject.type)}, {token.text!r} is none")


def _plain_number(subject: Subject, token: Token) -> int | float:
    if token.unit:
        position = token.start + len(token.text)
        raise FilterError(
            subject.expression, position, f"{subject.name} is no time, {token.unit!r} means nothing here"
        )
    if _is_hex(token) or token.text.lstrip("+-").isdecimal():
        return int_of(token)
    value = float(token.text)
    if math.isinf(value):
        subject.refuse(token, "this number is too large")
    return value


def _nanoseconds(subject: Subject, token: Token) -> Number:
    value = Fraction(int_of(token)) if _is_hex(token) else Fraction(token.text)
    unit = token.unit or subject.field.unit
    if not unit and value:
        subject.refuse(token, f"{subject.name} needs a unit: {token.text}ms, or us, ns, s")
    if unit and unit not in UNITS:
        raise FilterError(
            subject.expression, token.start + len(token.text), f"{unit!r} is no unit; ns, us, ms and s are"
        )
    value *= UNITS[unit] if unit else 1
    return value.numerator if value.denominator == 1 else value


def _moment(subject: Subject, token: Token) -> int:
    match = _MOMENT.fullmatch(token.text)
    if match is None:
        subject.refuse(token, f"{token.text!r} is no time such as '2024-05-01 12:00:00.5'")
    day, clock, fraction, zone = match.groups()
    try:
        moment = datetime.fromisoformat(f"{day}T{clock or '00:00'}{zone or 'Z'}")
    except ValueError as error:
        raise FilterError(subject.expression, token.start, f"{token.text!r} is no time: {error}") from error
    return (moment - _EPOCH) // timedelta(seconds=1) * 10**9 + int((fraction or "").ljust(9, "0"))


def _code(subject: Subject, token: Token) -> int:
    if token.kind in (TokenKind.WORD, TokenKind.TEXT):
        code = _CODES.get(token.text.upper())
        if code is None:
            subject.refuse(token, f"no HRESULT is called {token.text!r}{nearest(token.text, _CODES)}")
        return code
    if token.unit:
        subject.refuse(token, f"write a hexadecimal code as 0x{token.text}{token.unit}")
    if not (_is_hex(token) or token.text.lstrip("+-").isdecimal()):
        subject.refuse(token, f"{subject.name} is a whole number, or a name such as S_OK")
    value = int_of(token)
    if not -(2**31) <= value < 2**32:
        subject.refuse(token, "an HRESULT has 32 bits")
    return value
