"""What a filter asks of one value: functions from any value to bool, none of which ever raises."""

from __future__ import annotations

import ipaddress
import operator
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple, TypeAlias, TypeGuard

from bcapscope.protocol.codec.arguments import Argument
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.number_parsing import parse_integer
from bcapscope.traffic.observation import Endpoint

Match: TypeAlias = Callable[[object], bool]
Number: TypeAlias = "int | float | Fraction"
Address: TypeAlias = "ipaddress.IPv4Address | ipaddress.IPv6Address"

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
"""Names, commands and endpoints come back all the time and are short; what is longer is no name, and
remembering it would let a hostile peer fill the memory."""


class LiteralMatch(NamedTuple):
    """What a literal is compared for.

    Attributes:
        same_kind: whether a value can be compared with it at all; if not, it is neither equal nor different.
        equal: whether a value is equal to it.
    """

    same_kind: Match
    equal: Match


def plain_value(value: object) -> object:
    """Take the value out of an argument or a VARIANT."""
    while isinstance(value, (Argument, Variant)):
        value = value.value if isinstance(value, Variant) else value.variant.value
    return value


def element(value: object, index: int) -> object:
    """Give the plain element of a list, None where there is no list or no such element."""
    items = elements(value)
    return plain_value(items[index]) if index < len(items) else None


def elements(value: object) -> Sequence[object]:
    """Give the elements of a list (bytes are a list of numbers), none where the value is no list."""
    if type(value) is tuple:
        return value
    value = plain_value(value)
    return value if isinstance(value, (tuple, list, bytes)) and not isinstance(value, Endpoint) else ()


def is_number(value: object) -> TypeGuard[int | float]:
    """Tell whether it is a number; VT_BOOL is none."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def is_null(value: object) -> bool:
    """Tell whether there is no value."""
    return value is None


def is_true(value: object) -> bool:
    """Tell whether there is a value other than 0, false, an empty text and an empty list."""
    return bool(value)


def text_of(value: object) -> str | None:
    """Give what contains and ~ look at, None where the value is no text."""
    if isinstance(value, str):
        return value
    return str(value) if isinstance(value, Endpoint) else None


def _is_anything(value: object) -> bool:
    return True


def _is_text(value: object) -> TypeGuard[str]:
    return isinstance(value, str)


def _is_endpoint(value: object) -> TypeGuard[str | Endpoint]:
    return isinstance(value, (str, Endpoint))


def _is_code(value: object) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool)


NULL = LiteralMatch(_is_anything, is_null)


def number(wanted: Number) -> LiteralMatch:
    """Want a number."""
    return LiteralMatch(is_number, lambda value: value == wanted and not isinstance(value, bool))


def boolean(wanted: bool) -> LiteralMatch:
    """Want true or false; the numbers 1 and 0 are neither."""
    return LiteralMatch(lambda value: isinstance(value, bool), lambda value: value is wanted)


def text(wanted: str) -> LiteralMatch:
    """Want a text, without regard to case."""
    folded = wanted.casefold()
    return LiteralMatch(_is_text, lambda value: _is_text(value) and value.casefold() == folded)


def code(wanted: int) -> LiteralMatch:
    """Want an HRESULT, however signed."""
    unsigned = wanted & _U32
    return LiteralMatch(_is_code, lambda value: _is_code(value) and value & _U32 == unsigned)


def endpoint(address: Address, port: int | None) -> LiteralMatch:
    """Want an address, with that port or with any where `port` is None."""

    def equal(value: object) -> bool:
        found = parse_endpoint(value) if _is_endpoint(value) else None
        return found is not None and found[0] == address and (port is None or found[1] == port)

    return LiteralMatch(_is_endpoint, equal)


def parse_endpoint(value: str | Endpoint) -> tuple[Address, int | None] | None:
    """Read ``10.0.0.2``, ``10.0.0.2:5007``, ``::1``, ``[::1]`` or ``[::1]:5007``; None for anything else."""
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
    try:
        return ipaddress.ip_address(host), _parse_port(port)
    except ValueError:
        return None


def _parse_port(written: str) -> int | None:
    if not written:
        return None
    port = parse_integer(written, 0, 0xFFFF)
    if port is None:
        raise ValueError(written)
    return port


def equality(wanted: Sequence[LiteralMatch], negated: bool) -> Match:
    """Match a value that is equal to one of `wanted`, or if `negated` one that could be but is not."""
    same_kind = _any_of([one.same_kind for one in wanted])
    equal = _any_of([one.equal for one in wanted])
    return (lambda value: same_kind(value) and not equal(value)) if negated else equal


def _any_of(matches: Sequence[Match]) -> Match:
    if len(matches) == 1:
        return matches[0]

    def match(value: object) -> bool:
        for one in matches:  # noqa: SIM110  # twice as fast as any() over a generator
            if one(value):
                return True
        return False

    return match


def order(sign: str, wanted: Number) -> Match:
    """Match a number by an ordering sign; not a number is neither above nor below anything."""
    compare = ORDERINGS[sign]
    return lambda value: is_number(value) and compare(value, wanted)


def code_order(sign: str, wanted: int, signed: bool) -> Match:
    """Match an HRESULT by an ordering sign, read as signed or unsigned."""
    compare = ORDERINGS[sign]
    flip = _SIGN_BIT if signed else 0
    limit = (wanted & _U32) ^ flip
    return lambda value: _is_code(value) and compare((value & _U32) ^ flip, limit)


def contains(wanted: str | int | float) -> Match:
    """Match a text that has `wanted` in it, or a list that has it, or a text with it, as an element."""
    if not isinstance(wanted, str):
        return _has_number(wanted)
    folded = wanted.casefold()
    return _in_text_or_element(lambda text: folded in text.casefold())


def _has_number(wanted: int | float) -> Match:
    """Match a list that has a number as an element.

    A frame can hold 260,000 numbers and a relay waits meanwhile, so the interpreter looks at them, not Python
    code: then 65,536 of them take a millisecond. All elements of a list are of one type.
    """
    equal = number(wanted).equal
    is_byte = 0 <= wanted <= _LARGEST_BYTE and wanted == int(wanted)

    def match(value: object) -> bool:
        items = elements(value)
        if isinstance(items, bytes):
            return is_byte and int(wanted) in items
        if not items or isinstance(items[0], (Argument, Variant)):
            return any(equal(plain_value(item)) for item in items)
        return not isinstance(items[0], bool) and wanted in items

    return match


def search(pattern: str) -> Match:
    """Match a text, or a list with an element, in which a regular expression is found.

    RE2 takes time in proportion to the text, whatever the expression is.

    Raises:
        ValueError: it is none that RE2 takes; the arguments are RE2's reason and the part at fault.
    """
    import re2  # noqa: PLC0415  # slow to import, and most filters have no regular expression

    options = re2.Options()
    options.log_errors = False
    options.never_capture = True
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
        return any(isinstance(item, str) and test(item) for item in map(plain_value, elements(value)))

    return match
