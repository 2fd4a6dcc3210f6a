r"""The filter syntax for frames, calls, rules and views.

A filter consists of comparisons, joined by and, or, not (or &&, ||, !) and
parentheses. Precedence, highest first: not, and, or.

    function == Robot_Execute && command ~ "slv" && latency > 5ms
    hresult != S_OK and not (src == 10.0.0.2 or dst == 10.0.0.2:50001)

A comparison has a field on the left, then one of

    == !=                equal, not equal
    < <= > >=            for numbers, times, durations and HRESULTs
    in (a, b)            equal to one of the values; also in [a, b] and
                         not in (a, b)
    contains             text that contains this part; list with this element,
                         or with a text that contains this part
    ~ or matches         text, or list with a text, that matches this regular
                         expression (RE2 syntax) anywhere

arg[2][0] is the first element of the third argument: indexes start at 0 and
work on every list. A field can be a condition without a comparison. A field
without a comparison is false if its value is missing, 0, false, an empty text
or an empty list. The words true and false are conditions, too.

On the right is one of

    12  -3  2.5  0x40    number
    5ms                  time or duration with its unit: ns, us, ms, s
    reserved             another field of the same type, for numbers, times
                         and durations
    slvMove  "reply late"
                         text, in quotes ("..." or '...') unless it is one
                         plain word; \\ \" \' \n \r \t \xHH \uHHHH are
                         escapes, any other backslash is literal
    S_OK  0x83500121  -2091908831
                         HRESULT, signed or unsigned
    10.0.0.2  10.0.0.2:5007  [::1]:5007
                         endpoint; without a port, any port matches
    "2024-05-01 12:00:00.5"
                         time in UTC, or with a zone such as +09:00. A
                         number without a unit is in seconds since 1970.
                         For seconds since the first frame, compare t
    true  false  null

Text comparisons ignore case, as controllers do. Regular expressions ignore
case, too, unless they contain (?-i). A VT_R4 seldom equals a decimal exactly;
compare it with a range.

The operators < <= > >= compare an HRESULT with the value on the right. If this
value is a decimal number below 2147483648, both are compared as signed
numbers. If this value is a name, a hexadecimal number or a larger decimal
number, both are compared as unsigned numbers. For example, hresult < 0 selects
the same replies as hresult >= 0x80000000.

A comparison is false if the field has no value, or a value of another type.
Even the comparisons != and "not in" are false if the field has no value. For
example, a request has no hresult, so hresult != S_OK selects only replies.
The filter not (hresult == S_OK) also selects requests, because a request has
no hresult. Comparisons with null are different. The comparison field == null
is true if the field has no value. The comparison field != null is true if the
field has a value.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn, TypeAlias, TypeVar

from bcapscope.messages import Message
from bcapscope.traffic.filter import matching, operands
from bcapscope.traffic.filter.field_table import (
    FIELD_BY_NAME,
    SINCE_FIRST,
    FilterField,
    RecordKind,
    fields_of,
)
from bcapscope.traffic.filter.matching import Match
from bcapscope.traffic.filter.operands import ComparedField
from bcapscope.traffic.filter.tokens import FilterError, Token, TokenKind, tokenize, with_nearest

__all__ = ["Filter", "FilterError", "compile_filter"]

DEEPEST_PARENTHESES = 40
"""Maximum depth of nested parentheses, far below Python's recursion limit."""

R = TypeVar("R")
Getters: TypeAlias = Mapping[str, Callable[[Any], object]]
Test: TypeAlias = Callable[[Any], bool]


@dataclass(frozen=True, slots=True)
class Filter:
    """A valid filter expression.

    Attributes:
        getter_names: Names of the getters that `bind` needs.
        warnings: Comparisons that are valid, but probably a mistake.
        unknown_values: Values that are missing from bcapscope's tables; they may be typing mistakes.
    """

    expression: str
    kind: RecordKind
    getter_names: frozenset[str]
    warnings: tuple[Message, ...]
    unknown_values: tuple[Message, ...]

    def bind(
        self, getters: Mapping[str, Callable[[R], object]], first_time: Callable[[], int] | None = None
    ) -> Callable[[R], bool]:
        """Return a function that tests a record. The function raises only exceptions that a getter raises.

        Args:
            getters: For each name in `getter_names`, a function that reads this field of a record. `bind`
                ignores getters with other names. If the getter of `t` is missing, `bind` creates it.
            first_time: Function that returns the time at which the field `t` is 0, ns since 1970. If
                `first_time` is None, `t` is 0 at the time of the first tested record.

        Raises:
            KeyError: A getter in `getter_names` is missing.
        """
        if SINCE_FIRST not in self.getter_names or SINCE_FIRST in getters:
            return _Parser(self.expression, self.kind, getters).parse()
        elapsed = _ElapsedTime(getters["time" if self.kind is RecordKind.FRAME else "started"], first_time)
        test = _Parser(self.expression, self.kind, {**getters, SINCE_FIRST: elapsed.of_record}).parse()
        return test if first_time is not None else lambda record: elapsed.note(record) and test(record)


@dataclass
class _ElapsedTime:
    time_of: Callable[[Any], object]
    first_time: Callable[[], int] | None
    noted: int | None = None

    def note(self, record: object) -> bool:
        """Start `t` at the time of the first record. Return True for every record."""
        time = self.time_of(record)
        if self.noted is None and isinstance(time, int):
            self.noted = time
        return True

    def of_record(self, record: object) -> int | None:
        time = self.time_of(record)
        first = self.noted if self.first_time is None else self.first_time()
        return time - first if isinstance(time, int) and first is not None else None


def compile_filter(expression: str, kind: RecordKind) -> Filter:
    """Compile a filter expression for frames or for calls.

    Raises:
        FilterError: The expression is invalid, or uses a field that records of this kind do not have.
    """
    # The parser here only checks the expression and never calls a getter, so `bool` replaces every getter.
    parser = _Parser(expression, kind, dict.fromkeys(FIELD_BY_NAME, bool))
    parser.parse()
    names = frozenset(parser.getter_names)
    return Filter(expression, kind, names, tuple(parser.warnings), tuple(parser.unknown_values))


class _Parser:
    """Recursive-descent parser. Each method `parse_...` consumes the tokens of one construct."""

    def __init__(self, expression: str, kind: RecordKind, getters: Getters) -> None:
        self.expression = expression
        self.kind = kind
        self.getters = getters
        self.fields = fields_of(kind)
        self.getter_names: set[str] = set()
        self.warnings: list[Message] = []
        self.unknown_values: list[Message] = []
        self.tokens = tokenize(expression)
        self.position = 0
        self.depth = 0

    def parse(self) -> Test:
        if self.peek().kind is TokenKind.END:
            self.fail_at(self.peek(), Message("filter.empty"))
        test = self.parse_or()
        if self.peek().kind is not TokenKind.END:
            self.fail_at(self.peek(), Message("filter.no-end"))
        return test

    def peek(self) -> Token:
        return self.tokens[self.position]

    def advance(self) -> Token:
        token = self.tokens[self.position]
        if token.kind is not TokenKind.END:
            self.position += 1
        return token

    def accept(self, sign: str, word: str = "") -> bool:
        """Consume the next token if it is this sign or word; return whether it was consumed."""
        found = self.peek().is_sign(sign) or self.peek().is_word(word)
        self.position += found
        return found

    def expect(self, sign: str, reason: Message) -> None:
        if not self.accept(sign):
            self.fail_at(self.peek(), reason)

    def fail_at(self, token: Token, reason: Message) -> NoReturn:
        raise FilterError(self.expression, token.start, reason)

    def parse_or(self) -> Test:
        tests = [self.parse_and()]
        while self.accept("||", "or"):
            tests.append(self.parse_and())
        return matching.any_of(tests)

    def parse_and(self) -> Test:
        tests = [self.parse_not()]
        while self.accept("&&", "and"):
            tests.append(self.parse_not())
        return matching.all_of(tests)

    def parse_not(self) -> Test:
        negated = False
        while self.accept("!", "not"):
            negated = not negated
        test = self.parse_group() if self.peek().is_sign("(") else self.parse_comparison()
        return (lambda record: not test(record)) if negated else test

    def parse_group(self) -> Test:
        opening = self.advance()
        self.depth += 1
        if self.depth > DEEPEST_PARENTHESES:
            self.fail_at(opening, Message("filter.too-deep", limit=DEEPEST_PARENTHESES))
        test = self.parse_or()
        self.expect(")", Message("filter.no-group-end"))
        self.depth -= 1
        return test

    def parse_comparison(self) -> Test:
        if self.peek().is_word("true", "false"):
            value = self.advance().is_word("true")
            return lambda record: value
        subject, path = self.parse_subject()
        read = _reader(self.getter(subject.field), path)
        test = self.parse_field_comparison(subject, read)
        if test is not None:
            return test
        match = self.parse_match(subject)
        return lambda record: match(read(record)) is True

    def parse_subject(self) -> tuple[ComparedField, list[int]]:
        """Consume a field name and its indexes. Return the left side of the comparison, and the indexes."""
        token = self.advance()
        if token.kind is not TokenKind.WORD:
            case = "filter.no-field-but" if token.text else "filter.no-field"
            self.fail_at(token, Message(case, text=f"{token.text!r}"))
        if token.text not in self.fields:
            self.fail_at(token, self.unknown_field(token.text))
        field = self.fields[token.text]
        subject = ComparedField(self.expression, field, token.text, field.type, token.start)
        path: list[int] = []
        while self.peek().is_sign("["):
            subject = self.parse_index(subject, path)
        return subject, path

    def parse_index(self, subject: ComparedField, path: list[int]) -> ComparedField:
        opening, index = self.advance(), self.advance()
        type_ = subject.type.element
        if type_ is None:
            self.fail_at(opening, Message("filter.no-list", name=subject.name))
        if index.kind is not TokenKind.NUMBER or not index.text.isdecimal() or index.unit:
            self.fail_at(index, Message("filter.no-index"))
        self.expect("]", Message("filter.no-bracket"))
        path.append(int(index.text))
        return subject._replace(type=type_, name=f"{subject.name}[{index.text}]")

    def getter(self, field: FilterField) -> Callable[[Any], object]:
        self.getter_names.add(field.getter_name)
        return self.getters[field.getter_name]

    def unknown_field(self, name: str) -> Message:
        if name in FIELD_BY_NAME:
            return Message(f"filter.not-of-{self.kind}s", name=name)
        return with_nearest(Message("input.no-such-field", name=f"{name!r}"), name, self.fields)

    def parse_field_comparison(self, subject: ComparedField, read: Callable[[Any], object]) -> Test | None:
        """Parse a comparison of two fields of the same numeric type, such as ``serial == reserved``. The left
        field is already consumed. If no such comparison follows, consume nothing and return None.
        """
        sign = self.peek()
        if not (sign.is_sign(*matching.COMPARISONS) and subject.type in operands.NUMERIC):
            return None
        name = self.tokens[self.position + 1]
        found = self.fields.get(name.text) if name.kind is TokenKind.WORD else None
        if found is None or found.type is not subject.type:
            return None
        self.position += 2
        compare, read_other = matching.COMPARISONS[sign.text], self.getter(found)
        is_number = matching.is_number

        def test(record: Any) -> bool:
            value, limit = read(record), read_other(record)
            return is_number(value) and is_number(limit) and compare(value, limit)

        return test

    def parse_match(self, subject: ComparedField) -> Match:
        """Consume a comparison operator and its right side. Return a test for the value on the left side.

        If no operator follows, the field on the left side is the whole condition. `parse_match` then consumes
        nothing and returns `bool`, which is true unless the value is missing, 0, false or empty.
        """
        sign = self.peek()
        if sign.is_sign("==", "!="):
            self.advance()
            return self.equality(subject, [self.advance()], negated=sign.text == "!=")
        if sign.is_sign(*matching.ORDERINGS):
            self.advance()
            self.warnings += operands.doubts(subject, sign.text, self.peek())
            return operands.order(subject, sign.text, self.advance())
        if self.accept("~", "matches"):
            return operands.search(subject, self.advance())
        if self.accept("", "contains"):
            return operands.contains(subject, self.advance())
        if sign.is_word("in", "not"):
            return self.parse_membership(subject)
        return bool

    def parse_membership(self, subject: ComparedField) -> Match:
        negated = self.accept("", "not")
        if not self.accept("", "in"):
            self.fail_at(self.peek(), Message("filter.no-in"))
        return self.equality(subject, self.parse_choices(subject), negated)

    def equality(self, subject: ComparedField, literals: list[Token], negated: bool) -> Match:
        match = operands.equality(subject, literals, negated)
        for literal in literals:
            self.warnings += operands.doubts(subject, "==", literal)
            self.unknown_values += operands.unknown_value(subject, literal)
        return match

    def parse_choices(self, subject: ComparedField) -> list[Token]:
        opening = self.advance()
        if not opening.is_sign("(", "["):
            self.fail_at(opening, Message("filter.no-choices"))
        literals: list[Token] = []
        while not literals or self.accept(","):
            literal = self.advance()
            operands.check_literal(subject, literal)
            literals.append(literal)
        closing = ")" if opening.text == "(" else "]"
        self.expect(closing, Message("filter.no-comma", closing=closing))
        return literals


def _reader(get: Callable[[Any], object], path: Sequence[int]) -> Callable[[Any], object]:
    if not path:
        return get
    element = matching.element

    def read(record: Any) -> object:
        value = get(record)
        for index in path:
            value = element(value, index)
        return value

    return read
