"""Create the functions with which a filter tests values of any type. These functions raise no exception."""

from __future__ import annotations

import ipaddress
import operator
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Any, TypeAlias, TypeGuard, TypeVar

from bcapscope.protocol.codec.arguments import Argument
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.number_parsing import parse_integer
from bcapscope.traffic.observation import Endpoint

Match: TypeAlias = Callable[[object], bool | None]
"""Function that returns whether the value of a field matches the literal in a filter. If the value and the
literal have different types, a test for equality returns None, so that == and != are both false. All tests
other than equality, such as < and ``contains``, return False for a value of an unsuitable type.
"""

Number: TypeAlias = "int | float | Fraction"
Address: TypeAlias = "ipaddress.IPv4Address | ipaddress.IPv6Address"
T = TypeVar("T")

ORDERINGS: dict[str, Callable[[Number, Number], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
COMPARISONS = {"==": operator.eq, "!=": operator.ne, **ORDERINGS}

_U32 = 0xFFFFFFFF
_SIGN_BIT = 0x80000000
_LARGEST_BYTE = 0xFF
_REMEMBERED = 1024
_LONGEST_REMEMBERED = 128
"""Maximum length of a text whose test result is cached, so that no client can fill the memory."""


def plain_value(value: object) -> object:
    while isinstance(value, (Argument, Variant)):
        value = value.value if isinstance(value, Variant) else value.variant.value
    return value


def element(value: object, index: int) -> object:
    """Return an element of a list as a plain value; None if the list is too short."""
    items = elements(value)
    return plain_value(items[index]) if index < len(items) else None


def elements(value: object) -> Sequence[object]:
    """Return the elements of a list; () if the value is not a list. A bytes value is a list of numbers."""
    if type(value) is tuple:
        return value
    value = plain_value(value)
    return value if isinstance(value, (tuple, list, bytes)) and not isinstance(value, Endpoint) else ()


def is_number(value: object) -> TypeGuard[Number]:
    """Return whether a value is a number. A VT_BOOL is no number."""
    return isinstance(value, (int, float, Fraction)) and not isinstance(value, bool)


def text_of(value: object) -> str | None:
    """Return the text in which ``contains`` and ``~`` search; None if the value is no text."""
    if isinstance(value, str):
        return value
    return str(value) if isinstance(value, Endpoint) else None


def null(value: object) -> bool:
    return value is None


def number(wanted: Number) -> Match:
    # for nearly all values, the check of the type is faster than `is_number`
    return lambda value: value == wanted if type(value) is int or is_number(value) else None


def boolean(wanted: bool) -> Match:
    """The numbers 1 and 0 are no booleans."""
    return lambda value: value is wanted if isinstance(value, bool) else None


def text(wanted: str) -> Match:
    folded = wanted.casefold()
    return lambda value: value.casefold() == folded if isinstance(value, str) else None


def code(wanted: int) -> Match:
    """Match an HRESULT, whether it is signed or unsigned."""
    unsigned = wanted & _U32
    return lambda value: value & _U32 == unsigned if _is_code(value) else None


def _is_code(value: object) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool)


def endpoint(address: Address, port: int | None) -> Match:
    """Match an IP address and a port (None for any port). In a call through a proxy, either leg can match."""

    def match(value: object) -> bool | None:
        if type(value) is tuple:
            return any(map(match, value))
        if not isinstance(value, (str, Endpoint)):
            return None
        found = parse_endpoint(value)
        return found is not None and found[0] == address and (port is None or found[1] == port)

    return match


def parse_endpoint(value: str | Endpoint) -> tuple[Address, int | None] | None:
    """Parse ``10.0.0.2``, ``10.0.0.2:5007``, ``::1``, ``[::1]`` or ``[::1]:5007``; None for other text."""
    written = str(value)
    return _parse_endpoint(written) if len(written) <= _LONGEST_REMEMBERED else None


@lru_cache(_REMEMBERED)
def _parse_endpoint(written: str) -> tuple[Address, int | None] | None:
    host, port = written, ""
    if written.startswith("["):
        host, closed, port = written[1:].partition("]")
        if not closed or (port and not port.startswith(":")):
            return None
        port = port[1:] if port else ""
    elif written.count(":") == 1:
        host, _, port = written.partition(":")
    port_number = parse_integer(port, 0, 0xFFFF)
    if port and port_number is None:
        return None
    try:
        return ipaddress.ip_address(host), port_number
    except ValueError:
        return None


def equality(wanted: Sequence[Match], negated: bool) -> Match:
    """Match any of the `wanted` literals, or none if `negated`. A value of another type never matches."""
    if not negated:
        return any_of(wanted)
    first, *others = wanted
    if not others:
        return lambda value: first(value) is False

    def match(value: object) -> bool:
        results = {equal(value) for equal in wanted}
        return False in results and True not in results

    return match


def any_of(tests: Sequence[Callable[[Any], T]]) -> Callable[[Any], T | bool]:
    first, *others = tests
    if not others:
        return first

    def test(value: object) -> bool:
        for one in tests:  # noqa: SIM110  # twice as fast as any() over a generator
            if one(value):
                return True
        return False

    return test


def all_of(tests: Sequence[Callable[[Any], T]]) -> Callable[[Any], T | bool]:
    first, *others = tests
    if not others:
        return first

    def test(value: object) -> bool:
        for one in tests:  # noqa: SIM110  # twice as fast as all() over a generator
            if not one(value):
                return False
        return True

    return test


def order(sign: str, wanted: Number) -> Match:
    """Match a number if ``<number> <sign> <wanted>`` is true. NaN never matches."""
    compare = ORDERINGS[sign]
    return lambda value: is_number(value) and compare(value, wanted)


def code_order(sign: str, wanted: int, signed: bool) -> Match:
    """Match an HRESULT if ``<HRESULT> <sign> <wanted>`` is true. Compare HRESULT and `wanted` as signed
    numbers if `signed`, otherwise as unsigned numbers.
    """
    compare = ORDERINGS[sign]
    flip = _SIGN_BIT if signed else 0
    limit = (wanted & _U32) ^ flip
    return lambda value: _is_code(value) and compare((value & _U32) ^ flip, limit)


def contains(wanted: str | int | float) -> Match:
    """Match a text that contains `wanted`, or a list with an element that equals or contains `wanted`."""
    if not isinstance(wanted, str):
        return _has_number(wanted)
    folded = wanted.casefold()
    return _in_text_or_element(lambda text: folded in text.casefold())


def _has_number(wanted: int | float) -> Match:
    """Match a list that contains the number `wanted`.

    The proxy forwards nothing while it searches a frame, which can contain 260,000 numbers. The operator `in`
    searches 65,536 numbers in a millisecond. All elements of a list in a frame have the same type.
    """
    equal = number(wanted)
    is_byte = 0 <= wanted <= _LARGEST_BYTE and wanted == int(wanted)

    def match(value: object) -> bool:
        items = elements(value)
        if isinstance(items, bytes):
            return is_byte and int(wanted) in items
        first = next(iter(items), None)
        if isinstance(first, (Argument, Variant)):
            return any(equal(plain_value(item)) for item in items)
        return not isinstance(first, bool) and wanted in items

    return match


def search(pattern: str) -> Match:
    """Return a function that searches a text, or each text of a list, for an RE2 expression.

    Raises:
        ValueError: `pattern` is invalid. The error has two arguments: RE2's reason and the invalid part.
    """
    import re2  # noqa: PLC0415  # slow to import, and most filters have no regular expression

    options = re2.Options()
    options.log_errors = False
    options.case_sensitive = False
    try:
        compiled = re2.compile(pattern.encode("utf-8", "surrogatepass"), options)
    except re2.error as error:
        reason, _, part = error.args[0].decode("utf-8", "replace").partition(": ")
        raise ValueError(reason, part) from error

    def found(text: str) -> bool:
        return compiled.search(text.encode("utf-8", "surrogatepass")) is not None

    remembered = lru_cache(_REMEMBERED)(found)
    return _in_text_or_element(
        lambda text: remembered(text) if len(text) <= _LONGEST_REMEMBERED else found(text)
    )


def _in_text_or_element(test: Callable[[str], bool]) -> Match:
    def match(value: object) -> bool:
        text = text_of(value)
        if text is not None:
            return test(text)
        texts = map(text_of, map(plain_value, elements(value)))
        return any(each is not None and test(each) for each in texts)

    return match
