"""Filter expressions made at random, and what they mean, worked out the slow and plain way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

from hypothesis import strategies as st

TEXTS = (
    "slvMove",
    "SLVMOVE",
    "slvChangeMode",
    "TakeArm",
    "",
    "a b",
    "アーム",
    'x"y\\z',
    "null",
    "in",
    "serial",
)
SMALL = st.integers(-3, 3)
CODES = {"S_OK": 0, "S_FALSE": 1, "E_HANDLE": 0x80070006, "E_FAIL": 0x80004005}
NUMBERS = ("frame", "serial", "reserved", "length")
ORDERS = ("<", "<=", ">", ">=")
UNITS = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9, "": 10**9}


@dataclass(frozen=True)
class Comparison:
    """A field with indexes, a sign, and what stands on its right: as written, and as it is meant."""

    field: str
    path: tuple[int, ...]
    sign: str
    right: tuple[tuple[str, Any], ...] = ()


@dataclass(frozen=True)
class OtherField:
    """Right side that is a field."""

    name: str


@dataclass(frozen=True)
class Joined:
    """Parts joined by "and" or "or", or one part behind "not"."""

    word: str
    parts: tuple[Node, ...]


Node: TypeAlias = "Comparison | Joined"
Record: TypeAlias = "dict[str, Any]"


def _quote(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _number(value: int) -> st.SearchStrategy[tuple[str, Any]]:
    written = [str(value), f"{value}.0"] + ([hex(value)] if value >= 0 else [])
    return st.sampled_from(written).map(lambda text: (text, value))


NUMBER = SMALL.flatmap(_number)
TEXT = st.sampled_from(TEXTS).map(lambda text: (_quote(text), text)) | st.sampled_from(
    [("slvmove", "slvmove"), ("アーム", "アーム"), ("serial", "serial")]
)
NULL = st.just(("null", None))
BOOLEAN = st.booleans().map(lambda value: (str(value).lower(), value))
CODE = st.sampled_from(
    [(name, value) for name, value in CODES.items()]
    + [(hex(value), value) for value in CODES.values()]
    + [("-2147024890", 0x80070006), ("2147942406", 0x80070006), ("1", 1), ("-1", 0xFFFFFFFF)]
)
MOMENT = st.tuples(st.integers(0, 3), st.sampled_from(list(UNITS))).map(
    lambda pair: (f"{pair[0]}{pair[1]}", pair[0] * UNITS[pair[1]])
)
NO_PATH: st.SearchStrategy[tuple[int, ...]] = st.just(())
PATH = st.lists(st.integers(0, 3), min_size=1, max_size=3).map(tuple)


def _comparisons(
    fields: st.SearchStrategy[str],
    literal: st.SearchStrategy[tuple[str, Any]],
    *signs: str,
    path: st.SearchStrategy[tuple[int, ...]] = NO_PATH,
) -> st.SearchStrategy[Comparison]:
    one = st.tuples(literal)
    many = st.lists(literal | NULL, min_size=1, max_size=3).map(tuple)
    single = st.builds(Comparison, fields, path, st.sampled_from(signs), one)
    several = st.builds(Comparison, fields, path, st.sampled_from(["in", "not in"]), many)
    null = st.builds(Comparison, fields, path, st.sampled_from(["==", "!="]), st.tuples(NULL))
    bare = st.builds(Comparison, fields, path, st.just(""))
    return single | several | null | bare


OTHER = st.sampled_from(NUMBERS).map(lambda name: (name, OtherField(name)))
COMPARISONS = st.one_of(
    _comparisons(st.sampled_from(NUMBERS), NUMBER, "==", "!=", *ORDERS),
    _comparisons(st.just("time"), MOMENT, "==", "!=", *ORDERS),
    _comparisons(st.sampled_from(["command", "hresult_text"]), TEXT, "==", "!=", "contains"),
    _comparisons(st.just("hresult"), CODE, "==", "!=", *ORDERS),
    _comparisons(st.just("arg"), NUMBER, "==", "!=", "contains", *ORDERS, path=PATH),
    _comparisons(st.just("arg"), TEXT, "==", "!=", "contains", path=PATH),
    _comparisons(st.just("arg"), BOOLEAN | NUMBER | TEXT, "==", "!=", path=PATH),
    st.builds(
        Comparison, st.sampled_from(["arg", "problems"]), NO_PATH, st.just("contains"), st.tuples(TEXT)
    ),
    st.builds(Comparison, st.just("arg"), NO_PATH, st.just("contains"), st.tuples(NUMBER)),
    st.builds(
        Comparison,
        st.sampled_from(NUMBERS),
        st.just(()),
        st.sampled_from(["==", "!=", *ORDERS]),
        st.tuples(OTHER),
    ),
)


def expressions() -> st.SearchStrategy[Node]:
    """Make filters over the fields of frames."""
    return st.recursive(
        COMPARISONS,
        lambda inner: (
            st.builds(
                Joined, st.sampled_from(["and", "or"]), st.lists(inner, min_size=2, max_size=3).map(tuple)
            )
            | st.builds(Joined, st.just("not"), st.tuples(inner))
        ),
        max_leaves=8,
    )


def records() -> st.SearchStrategy[Record]:
    """Make frames whose values often meet those of `expressions`."""
    numbers = st.none() | SMALL | st.sampled_from([0.0, 1.5, float("nan"), float("inf")])
    texts = st.none() | st.sampled_from(TEXTS)
    scalars = numbers | texts | st.booleans()
    values = st.recursive(scalars, lambda inner: st.lists(inner, max_size=4).map(tuple), max_leaves=6)
    codes = st.sampled_from([*CODES.values(), -2147024890, -1, 0xFFFFFFFF, 0x0F200501])
    return st.fixed_dictionaries(
        {},
        optional={
            **dict.fromkeys(NUMBERS, numbers),
            "time": st.sampled_from([0, 1, 2_000, 1_000_000, 3 * 10**9]),
            "command": texts,
            "hresult_text": texts,
            "hresult": codes,
            "arg": st.lists(values | st.binary(max_size=3), max_size=4).map(tuple),
            "problems": st.lists(st.sampled_from(TEXTS), max_size=2),
        },
    )


def write(node: Node, inside: str = "or") -> str:
    """Write a filter with no more parentheses than it needs."""
    if isinstance(node, Comparison):
        return _write_comparison(node)
    if node.word == "not":
        return f"not {write(node.parts[0], 'not')}"
    rank = ["or", "and", "not"]
    text = f" {node.word} ".join(write(part, _next(node.word)) for part in node.parts)
    return f"({text})" if rank.index(node.word) < rank.index(inside) else text


def _next(word: str) -> str:
    return "and" if word == "or" else "not"


def _write_comparison(node: Comparison) -> str:
    left = node.field + "".join(f"[{index}]" for index in node.path)
    if not node.sign:
        return left
    texts = [text for text, _ in node.right]
    return f"{left} {node.sign} " + (f"({', '.join(texts)})" if node.sign.endswith("in") else texts[0])


def evaluate(node: Node, record: Record) -> bool:
    """Tell what a filter says of a record."""
    if isinstance(node, Comparison):
        return _compare(node, record)
    results = [evaluate(part, record) for part in node.parts]
    return {"and": all(results), "or": any(results), "not": not results[0]}[node.word]


def _compare(node: Comparison, record: Record) -> bool:
    value = _read(record.get(node.field), node.path)
    if not node.sign:
        return bool(value)
    meant = [record.get(m.name) if isinstance(m, OtherField) else m for _, m in node.right]
    if node.right and isinstance(node.right[0][1], OtherField):
        return _is_number(value) and _is_number(meant[0]) and _ordered(node.sign, value, meant[0])
    if node.sign in ORDERS:
        return _is_number(value) and _ordered(node.sign, *_as_ordered(node, value, meant[0]))
    if node.sign == "contains":
        return _contains(value, meant[0])
    equal = any(_equal(node.field, value, m) for m in meant)
    return equal if node.sign in ("==", "in") else not equal and any(_comparable(value, m) for m in meant)


def _read(value: Any, path: tuple[int, ...]) -> Any:
    for index in path:
        value = value[index] if isinstance(value, tuple | list | bytes) and index < len(value) else None
    return value


def _comparable(value: Any, meant: Any) -> bool:
    return meant is None or _kind(value) == _kind(meant)


def _as_ordered(node: Comparison, value: Any, meant: Any) -> tuple[Any, Any]:
    """For HRESULTs, read both sides as the way of writing the right one tells."""
    if node.field != "hresult":
        return value, meant
    value, meant = value % 2**32, meant % 2**32
    written = node.right[0][0]
    if "0x" in written or "_" in written or int(written) >= 2**31:
        return value, meant
    return (value + 2**31) % 2**32, (meant + 2**31) % 2**32


def _ordered(sign: str, left: Any, right: Any) -> bool:
    outcomes = {"<": left < right, "<=": left <= right, ">": left > right, ">=": left >= right}
    return bool({**outcomes, "==": left == right, "!=": left != right}[sign])


def _is_number(value: Any) -> bool:
    return type(value) in (int, float)


def _kind(value: Any) -> str:
    return "number" if _is_number(value) else type(value).__name__


def _equal(field: str, value: Any, meant: Any) -> bool:
    if _kind(value) != _kind(meant):
        return False
    if field == "hresult" and value is not None:
        return bool((value - meant) % 2**32 == 0)
    return bool(value.casefold() == meant.casefold() if isinstance(value, str) else value == meant)


def _contains(value: Any, part: Any) -> bool:
    if isinstance(value, str):
        return isinstance(part, str) and part.casefold() in value.casefold()
    if not isinstance(value, tuple | list | bytes):
        return False
    return any(
        part.casefold() in item.casefold()
        if isinstance(item, str) and isinstance(part, str)
        else _kind(item) == _kind(part) == "number" and item == part
        for item in value
    )
