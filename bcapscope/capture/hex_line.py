"""Split one line of pasted text into hex and prose.

The line may come from hexdump, xxd, od, tcpdump, Wireshark, the b-CAP Tester or source code. Around the
bytes, the line may have an offset, the bytes as characters, prefixes and commas.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Sequence
from typing import NamedTuple, TypeAlias

import msgspec

MIN_HEX_BYTES = 8
"""Minimum number of adjacent bytes that count as hex in the middle of prose. Dates, MAC addresses and words
such as "facade" are shorter than this minimum. The smallest argument of a frame has ten bytes.
"""

LONGEST_ROW = 512
"""Longest line in which a column of characters is searched. A dump of 64 bytes per row has 240 columns."""


# The pieces of a line are msgspec structs for speed: every line of a dump creates several pieces.
# Creating a struct takes 0.1 µs, creating a named tuple 0.4 µs, creating a frozen dataclass 0.9 µs.
# Unlike a named tuple, a struct never equals a struct of another class.
class ProseText(msgspec.Struct, frozen=True):
    text: str


class HexDigits(msgspec.Struct, frozen=True):
    """The hex digits of adjacent bytes in a line.

    Attributes:
        digits: Two digits per byte. The last byte has one digit if a long row was wrapped inside a byte.
        offset: Offset written before the bytes, with its colon but without 0x; "" if there is none.
        indent: Column at which the text of the line begins.
        is_hex_only: Whether the line holds only bytes, an offset and the bytes as characters.
        has_hex_notation: Whether the bytes have an offset, 0x or a backslash.
    """

    digits: str
    offset: str
    indent: int
    is_hex_only: bool
    has_hex_notation: bool
    starts_line: bool
    ends_line: bool


class RepeatMark(msgspec.Struct, frozen=True):
    """A line of one asterisk, which hexdump, od and xxd print in place of repeated lines."""


class EndOffset(msgspec.Struct, frozen=True):
    """A line of 4 to 8 hex digits: the offset at the end of a dump, or bytes."""

    digits: str


LinePiece: TypeAlias = ProseText | HexDigits | RepeatMark | EndOffset


class _Run(NamedTuple):
    start: int
    stop: int
    digits: str
    kind: str


_NOISE = re.compile(r"</?[A-Za-z][^<>]{0,80}>|/\*.{0,200}?\*/|\(byte\)|^\s*(?:>\s?)+|^\s*```\w*|\\\s*$")
"""Text to ignore: tags, comments, casts, quote marks of e-mails, code fences, and a final backslash."""

_ENTITIES = (("&nbsp;", " "), ("&lt;", "<"), ("&gt;", ">"))
_TOKEN = re.compile(r"[^\s,;|{}()\[\]\"'`\u201c\u201d\u2018\u2019]+")
_PAIR, _CHAIN, _GROUP, _ROW, _ESCAPED, _WORD = "pair", "chain", "group", "row", "escaped", "word"
_KINDS = (
    (
        _PAIR,
        re.compile(r"0[xX]([0-9A-Fa-f]{1,2})|\$?([0-9A-Fa-f]{2})[hH]?\.?|([0-9A-Fa-f]{2}-[0-9A-Fa-f]{2})"),
    ),
    (_CHAIN, re.compile(r"([0-9A-Fa-f]{2}([:\-.])[0-9A-Fa-f]{2}(?:\2[0-9A-Fa-f]{2})+)")),
    (_GROUP, re.compile(r"([0-9A-Fa-f]{4}|[0-9A-Fa-f]{8})")),
    (_ROW, re.compile(r"(?:0[xX])?((?:[0-9A-Fa-f]{2}){3,}|[0-9A-Fa-f]{15,})")),
)
_JOINABLE = {_PAIR: (_PAIR,), _GROUP: (_GROUP, _PAIR, _ROW), _ROW: (_ROW, _GROUP, _PAIR), _CHAIN: (_CHAIN,)}
"""For each kind of first token, the kinds that may follow. The last token of a row can be shorter."""

_OFFSET = re.compile(r"\s*(?:0[xX])?([0-9A-Fa-f]{2,16})(:?)(?=\s)")
_SHORTEST_BARE_OFFSET = 4
_MACHINE_OFFSETS = (6, 7)
"""Possible lengths, in digits, of an offset that hexdump or od prints. After the offset, these programs print
groups of bytes in the machine's byte order.
"""

_OCTAL_WORD = re.compile(r"[01][0-7]{5}")
_LONE_NUMBER = re.compile(r"\s*([0-9A-Fa-f]{4,8})\s*")
_LITERAL = re.compile(r"b?\"((?:\\.|[^\"\\])*)\"?|b?'((?:\\.|[^'\\])*)'?|((?:\\x[0-9A-Fa-f]{2}\s?)+)")
_ESCAPE = re.compile(r"\\x([0-9A-Fa-f]{2})|\\([0-7]{1,3})|\\(.)|(.)", re.DOTALL)
_NAMED = {"n": 10, "r": 13, "t": 9, "a": 7, "b": 8, "f": 12, "v": 11}
_MARK = re.compile(r"0[xX]|\\x")
_WORDS = re.compile(r"[^\W\d_]|[<>\u2190-\u21ff]")
"""Finds a letter, an arrow, or the tip of an arrow such as "->"."""


def parse_line(line: str) -> list[LinePiece]:
    """Split a line into hex and prose; [] for an empty line. Never raises."""
    line = unicodedata.normalize("NFKC", line)
    for entity, character in _ENTITIES:
        line = line.replace(entity, character)
    line = _NOISE.sub(" ", line)
    if line.strip() == "*":
        return [RepeatMark()]
    lone = _LONE_NUMBER.fullmatch(line)
    if lone:
        return [EndOffset(lone[1])]
    if "\\x" in line:
        return list(_pieces(line, list(_literals(line)), "", 0))
    offset, start = _leading_offset(line)
    if offset:
        return list(_pieces(line, _dump_row(line, start), offset, start))
    return list(_pieces(line, list(_hex_runs(line, start)), "", start))


def _leading_offset(line: str) -> tuple[str, int]:
    """Return the offset that begins a line, and the column after this offset; "" and 0 without offset."""
    match = _OFFSET.match(line)
    following = _TOKEN.search(line, match.end()) if match else None
    if match is None or following is None:
        return "", 0
    digits, colon = match.groups()
    kind = _classify_word(following[0])[0]
    is_dump = kind in (_GROUP, _ROW) and (colon or len(digits) in _MACHINE_OFFSETS)
    is_bytes = kind == _PAIR and (colon or len(digits) >= _SHORTEST_BARE_OFFSET)
    if not (is_dump or is_bytes):
        return "", 0
    return digits + colon, match.end()


def _dump_row(line: str, start: int) -> list[_Run]:
    """Return the bytes in a line with an offset. The rest of the line shows the same bytes as characters."""
    runs = list(_hex_runs(line, start))[:1]
    if not runs or ":" in line[:start] or runs[0].kind not in (_GROUP, _ROW):
        return runs
    words = [word for word in _TOKEN.findall(line, start) if _classify_word(word)[0] in (_GROUP, _ROW)]
    if all(map(_OCTAL_WORD.fullmatch, words)):
        words = [f"{int(word, 8):04x}" for word in words]
    digits = "".join(bytes.fromhex(word)[::-1].hex() for word in words if len(word) % 2 == 0)
    return [runs[0]._replace(digits=digits)]


def _hex_runs(line: str, start: int) -> Iterator[_Run]:
    group: list[_Run] = []
    for token in _tokens(line, start):
        if group and token.kind not in _JOINABLE[group[0].kind]:
            yield _make_run(line, group)
            group = []
        if token.kind != _WORD:
            group.append(token)
    if group:
        yield _make_run(line, group)


def _tokens(line: str, start: int) -> Iterator[_Run]:
    for match in _TOKEN.finditer(line, start):
        kind, digits = _classify_word(match[0])
        if kind != _WORD or _WORDS.search(match[0]) or any(map(str.isdigit, match[0])):
            yield _Run(match.start(), match.end(), digits, kind)


def _classify_word(word: str) -> tuple[str, str]:
    for kind, form in _KINDS:
        match = form.fullmatch(word)
        if match:
            digits = next(filter(None, match.groups())).translate({58: None, 45: None, 46: None})
            return kind, digits.rjust(2, "0")
    return _WORD, ""


def _make_run(line: str, group: Sequence[_Run]) -> _Run:
    """Join tokens into one run. Leave out the characters that a dump shows to the right of the bytes."""
    for index in range(1, len(group) + 1 if len(line) <= LONGEST_ROW else 0):
        stop = group[index].start if index < len(group) else len(line)
        between = line[group[index - 1].stop : stop]
        if index < len(group) and "  " not in between and "|" not in between:
            continue
        digits = "".join(token.digits for token in group[:index])
        if _are_characters(digits, line[group[index - 1].stop :]):
            return _Run(group[0].start, len(line), digits, group[0].kind)
    return _Run(group[0].start, group[-1].stop, "".join(token.digits for token in group), group[0].kind)


def _are_characters(digits: str, text: str) -> bool:
    """Return whether `text` shows the bytes of `digits`, with a dot for each byte that is not printable."""
    text = text.strip().strip("|")
    if text[:1] == ">" and text[-1:] == "<":
        text = text[1:-1]
    data = bytes.fromhex(digits[: len(digits) & ~1]).strip(b" ")
    text = text.strip()
    if not text or len(text) != len(data):
        return False
    return all(
        shown == chr(byte) if 0x20 <= byte < 0x7F else not shown.isalnum()
        for byte, shown in zip(data, text, strict=True)
    )


def _literals(line: str) -> Iterator[_Run]:
    for match in _LITERAL.finditer(line):
        if "\\x" in match[0]:
            values = [
                _escape_value(*parts) for parts in _ESCAPE.findall(next(filter(None, match.groups())).strip())
            ]
            if max(values) < 256:
                yield _Run(match.start(), match.end(), bytes(values).hex(), _ESCAPED)


def _escape_value(digits: str, octal: str, named: str, plain: str) -> int:
    if digits or octal:
        return int(digits, 16) if digits else int(octal, 8)
    return _NAMED.get(named, ord(named)) if named else ord(plain)


def _pieces(line: str, runs: list[_Run], offset: str, start: int) -> Iterator[LinePiece]:
    begins = [start, *(run.stop for run in runs)]
    ends = [*(run.start for run in runs), len(line)]
    outside = "".join(line[begin:end] for begin, end in zip(begins, ends, strict=True))
    alone = not _WORDS.search(outside) and not any(map(str.isdigit, outside))
    indent = len(line) - len(line.lstrip())
    pos = start
    for index, run in enumerate(runs):
        starts_line = index == 0 and not line[start : run.start].strip()
        ends_line = index == len(runs) - 1 and not line[run.stop :].strip()
        is_sure = len(run.digits) >= 2 * MIN_HEX_BYTES or alone or offset or run.kind == _ESCAPED
        if not (is_sure or (run.kind == _PAIR and (starts_line or ends_line))):
            continue
        yield from _prose(line[pos : run.start])
        marked = bool(offset or _MARK.search(line, run.start, run.stop))
        yield HexDigits(run.digits, offset, indent, alone, marked, starts_line, ends_line)
        pos = run.stop
    yield from _prose(line[pos:])


def _prose(text: str) -> Iterator[ProseText]:
    if _WORDS.search(text):
        yield ProseText(" ".join(text.split()))
