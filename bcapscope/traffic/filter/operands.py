"""Compile the right side of a comparison. If the right side does not fit the field on the left side, raise a
`FilterError`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from typing import NamedTuple, NoReturn

from bcapscope.messages import Message
from bcapscope.protocol.tables.hresult import CODE_BY_NAME, is_known_code
from bcapscope.traffic.filter import matching as matches
from bcapscope.traffic.filter.field_table import FieldType, FilterField
from bcapscope.traffic.filter.matching import Match, Number
from bcapscope.traffic.filter.tokens import FilterError, Token, TokenKind, with_nearest

UNITS = {"ns": 1, "us": 10**3, "µs": 10**3, "μs": 10**3, "ms": 10**6, "s": 10**9}
"""Number of nanoseconds in each unit. Users can write the unit of microseconds with the letter u, with the
micro sign or with the Greek letter mu.
"""

NUMERIC = frozenset({FieldType.NUMBER, FieldType.TIME, FieldType.DURATION})

_LISTS = frozenset({FieldType.NUMBERS, FieldType.TEXTS, FieldType.VALUES})
_EARLIEST_TIME = 100_000_000 * 10**9
"""1973-03-03, as ns since 1970. If a filter contains a time before 1973-03-03, this time is probably a
mistake, such as a number of seconds since the first frame.
"""

_RESERVED = ("and", "or", "not", "in", "contains", "matches")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_TIMESTAMP = re.compile(
    r"(\d{4}-\d\d-\d\d)(?:[T ](\d\d:\d\d(?::\d\d)?)(?:\.(\d{1,9}))?)?(Z|[+-]\d\d:\d\d)?", re.ASCII
)


class ComparedField(NamedTuple):
    """The left side of a comparison, which begins at index `start` of the filter `expression`. `type` is the
    type of the field, or of the element that the indexes select.
    """

    expression: str
    field: FilterField
    name: str
    type: FieldType
    start: int

    def mismatch(self, case: str, **places: str) -> Message:
        """Return the message ``filter.<case>``, with the names of the field and of its type."""
        type_ = Message(f"filter.type.{self.type.name.lower()}")
        return Message(f"filter.{case}", name=self.name, type=type_, **places)

    def fail_at(self, place: Token | int, reason: Message) -> NoReturn:
        raise FilterError(self.expression, place if isinstance(place, int) else place.start, reason)


def equality(compared: ComparedField, literals: Sequence[Token], negated: bool) -> Match:
    return matches.equality([_literal_match(compared, literal) for literal in literals], negated)


def order(compared: ComparedField, sign: str, literal: Token) -> Match:
    check_literal(compared, literal)
    if compared.type is FieldType.HRESULT:
        signed = literal.kind is TokenKind.NUMBER and not _is_hex(literal) and int_of(literal) < 2**31
        return matches.code_order(sign, _code(compared, literal), signed)
    if compared.type in NUMERIC or compared.type is FieldType.VALUE:
        return matches.order(sign, _number(compared, literal))
    compared.fail_at(compared.start, compared.mismatch("no-order"))


def contains(compared: ComparedField, literal: Token) -> Match:
    check_literal(compared, literal)
    if compared.type in NUMERIC or compared.type is FieldType.HRESULT:
        compared.fail_at(compared.start, compared.mismatch("contains-nothing"))
    if compared.type is FieldType.NUMBERS or (
        literal.kind is TokenKind.NUMBER and compared.type in (FieldType.VALUE, FieldType.VALUES)
    ):
        _check_number(compared, literal)
        return matches.contains(_plain_number(compared, literal))
    if literal.is_word("true", "false", "null"):
        compared.fail_at(literal, Message("filter.contains-operand"))
    if literal.kind is TokenKind.NUMBER:
        compared.fail_at(literal, compared.mismatch("contains-quotes"))
    return matches.contains(literal.text)


def search(compared: ComparedField, literal: Token) -> Match:
    if compared.type in NUMERIC or compared.type in (FieldType.HRESULT, FieldType.NUMBERS):
        compared.fail_at(compared.start, compared.mismatch("search-needs-text"))
    check_literal(compared, literal)
    if literal.kind not in (TokenKind.TEXT, TokenKind.WORD):
        compared.fail_at(literal, Message("filter.search-quotes"))
    try:
        return matches.search(literal.text)
    except ValueError as error:
        reason, part = error.args
        position = max(compared.expression.find(part, literal.start, literal.stop), literal.start)
        invalid = Message("filter.search-invalid", reason=reason)
        raise FilterError(compared.expression, position, invalid) from error


def doubts(compared: ComparedField, sign: str, literal: Token) -> Iterator[Message]:
    """Yield a warning if a time is compared with a time shortly after 1970, which is probably a mistake."""
    if compared.type is not FieldType.TIME or literal.kind is not TokenKind.NUMBER:
        return
    if -_EARLIEST_TIME < _nanoseconds(compared, literal) < _EARLIEST_TIME:
        number = f"{literal.text}{literal.unit}"
        yield Message("filter.time-since-1970", name=compared.name, sign=sign, number=number)


def unknown_value(compared: ComparedField, literal: Token) -> Iterator[Message]:
    """Yield a message if the literal is not among the known values of the field."""
    if compared.type is FieldType.HRESULT and literal.kind is TokenKind.NUMBER:
        if not is_known_code(int_of(literal)):
            yield Message("filter.unknown-value", name=compared.name, value=literal.text)
        return
    if literal.kind not in (TokenKind.WORD, TokenKind.TEXT) or literal.is_word("null"):
        return
    known = compared.field.known()
    if known and literal.text.casefold() not in map(str.casefold, known):
        unknown = Message("filter.unknown-value", name=compared.name, value=f"{literal.text!r}")
        yield with_nearest(unknown, literal.text, sorted(known))


def check_literal(compared: ComparedField, token: Token) -> None:
    """Raise a `FilterError` if a token is a sign, a reserved word, or the end of the expression."""
    if token.kind is TokenKind.END:
        compared.fail_at(token, Message("filter.no-operand", name=compared.name))
    if token.kind is TokenKind.SIGN:
        compared.fail_at(token, Message("filter.no-value", text=f"{token.text!r}"))
    if token.is_word(*_RESERVED):
        compared.fail_at(token, Message("filter.reserved", text=f"{token.text!r}"))


def int_of(token: Token) -> int:
    return int(token.text, 16) if _is_hex(token) else math.trunc(Fraction(token.text))


def _is_hex(token: Token) -> bool:
    return "x" in token.text.casefold()


def _literal_match(compared: ComparedField, token: Token) -> Match:
    check_literal(compared, token)
    if token.is_word("null"):
        return matches.null
    if compared.type in _LISTS:
        compared.fail_at(token, compared.mismatch("is-list"))
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


def _value(compared: ComparedField, token: Token) -> Match:
    if token.kind is TokenKind.NUMBER:
        return matches.number(_number(compared, token))
    if token.is_word("true", "false"):
        return matches.boolean(token.is_word("true"))
    return matches.text(token.text)


def _text(compared: ComparedField, token: Token) -> str:
    if token.kind is TokenKind.NUMBER:
        is_function = compared.field.name == "function"
        compared.fail_at(token, compared.mismatch("function-number" if is_function else "no-number"))
    values = compared.field.values
    if values and token.kind is TokenKind.WORD and token.text.casefold() not in map(str.casefold, values):
        never = Message("filter.never", name=compared.name, value=token.text)
        reason = with_nearest(never, token.text, values)
        if reason is never and len(values) <= 5:
            reason = Message("filter.one-of", reason=never, values=", ".join(values))
        compared.fail_at(token, reason)
    return token.text


def _endpoint(compared: ComparedField, token: Token) -> Match:
    found = matches.parse_endpoint(token.text) if token.kind in (TokenKind.ADDRESS, TokenKind.TEXT) else None
    if found is None:
        compared.fail_at(token, Message("filter.no-address", text=f"{token.text!r}"))
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
        compared.fail_at(token, compared.mismatch("is-none", text=f"{token.text!r}"))


def _plain_number(compared: ComparedField, token: Token) -> int | float:
    if token.unit:
        position = token.start + len(token.text)
        needless = Message("filter.needless-unit", name=compared.name, unit=f"{token.unit!r}")
        compared.fail_at(position, needless)
    if _is_hex(token) or token.text.lstrip("+-").isdecimal():
        return int_of(token)
    value = float(token.text)
    if math.isinf(value):
        compared.fail_at(token, Message("filter.large-number"))
    return value


def _nanoseconds(compared: ComparedField, token: Token) -> Number:
    value = Fraction(int_of(token)) if _is_hex(token) else Fraction(token.text)
    unit = token.unit or compared.field.unit
    if unit in UNITS:
        value *= UNITS[unit]
    elif unit:
        unknown = Message("filter.unknown-unit", unit=f"{unit!r}")
        compared.fail_at(token.start + len(token.text), unknown)
    elif value:
        compared.fail_at(token, Message("filter.no-unit", name=compared.name, number=token.text))
    return value.numerator if value.denominator == 1 else value


def _timestamp(compared: ComparedField, token: Token) -> int:
    match = _TIMESTAMP.fullmatch(token.text)
    if match is None:
        compared.fail_at(token, Message("filter.no-time", text=f"{token.text!r}"))
    day, clock, fraction, zone = match.groups()
    try:
        moment = datetime.fromisoformat(f"{day}T{clock or '00:00'}{zone or 'Z'}")
    except ValueError as error:
        invalid = Message("filter.invalid-time", text=f"{token.text!r}", reason=str(error))
        raise FilterError(compared.expression, token.start, invalid) from error
    return (moment - _EPOCH) // timedelta(seconds=1) * 10**9 + int((fraction or "").ljust(9, "0"))


def _code(compared: ComparedField, token: Token) -> int:
    if token.kind in (TokenKind.WORD, TokenKind.TEXT):
        code = CODE_BY_NAME.get(token.text.upper())
        if code is None:
            unknown = Message("filter.no-such-code", name=f"{token.text!r}")
            compared.fail_at(token, with_nearest(unknown, token.text, CODE_BY_NAME))
        return code
    if token.unit:
        compared.fail_at(token, Message("filter.write-hex", digits=f"{token.text}{token.unit}"))
    if not (_is_hex(token) or token.text.lstrip("+-").isdecimal()):
        compared.fail_at(token, Message("filter.no-code", name=compared.name))
    value = int_of(token)
    if not -(2**31) <= value < 2**32:
        compared.fail_at(token, Message("filter.code-bits"))
    return value
