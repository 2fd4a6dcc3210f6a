"""Translate sentences of lower layers, which are written in English only, into Japanese."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from itertools import islice, pairwise
from types import MappingProxyType
from typing import TypeVar

LONGEST = 1200
"""Characters of a sentence that is looked up: what is longer is no sentence of ours."""

_DEEPEST = 12
"""Phrases within phrases."""

_MAX_LOOKS = 300
"""Parts of one sentence that are looked up; a real one has a few dozen."""

_MAX_JOINTS = 24
"""Places at which a sentence is looked upon as two clauses; more have only lists of names."""

_JOINTS = MappingProxyType({"; ": "。", ": ": ": "})
"""What stands between clauses, in English and in Japanese."""

KINDS: Mapping[str, str] = MappingProxyType(
    {
        "axes": r"[A-Z]\w*(?:, [A-Z]\w*)*",
        "clause": r".+?",
        "client": r"[Yy]our client|[Cc]lient \S+(?: \((?:UDP|TCP)\))?",
        "code": r"0x[0-9A-F]+",
        "encodings": r"[A-Z].*",
        "frames": r"frames? \d[\d, ]*",
        "levels": r"\d+ × \d+(?:, \d+ × \d+)*",
        "n": r"[-+]?[\d.]+(?:e[-+]?\d+)?",
        "name": r".+?",
        "numbers": r"\d+(?:, \d+)*",
        "pair": r"\d+(?:,\d+)*(?: > \d+(?:,\d+)*)?",
        "span": r"-?[\d.]+ m?s",
        "text": r".+?",
        "time": r"-?\d+\.\d{3} s",
        "times": r"once|twice|\d+ times",
        "types": r"VT_\S+(?: or VT_\S+)*",
        "unit": r"\S*",
        "word": r"\S+?",
    }
)
"""What can stand in a place of a phrase, by the place's name without the digits at its end."""

_OPEN = frozenset(("clause", "name", "text", "word"))
_KEPT = frozenset(
    ("axes", "code", "encodings", "levels", "n", "name", "numbers", "pair", "span", "time", "unit", "word")
)
"""Kinds that are the same in Japanese; of a name from the wire or of a file no word is ever exchanged."""

_JOINT = re.compile("|".join(_JOINTS))
_PLACE = re.compile(r"\{([a-z]+\d*)\}")
_WIDE = re.compile("[\u3001-\u9fff\uff01-\uff60]")

T = TypeVar("T", str, str | None)


class _Pattern:
    """A phrase with places.

    Attributes:
        kinds: of the places, by their names.
        japanese: words, each with the name of the place behind them, "" at the end.
    """

    def __init__(self, english: str, japanese: str) -> None:
        """Take a phrase.

        Raises:
            KeyError: the Japanese has a place that the English lacks.
        """
        self._english = _taken_apart(english)
        self.japanese = _taken_apart(japanese)
        kinds = {name: name.rstrip("0123456789") for _, name in self._english if name}
        self.kinds = {name: kinds[name] for _, name in (*self._english, *self.japanese) if name}
        first, *others = (words for words, _ in self._english)
        self._mark = max((first[1:], *others), key=len)
        self.words = sum(len(words) for words, _ in self._english)
        self.open = sum(kind in _OPEN for kind in kinds.values())
        self._fits: Callable[[str], re.Match[str] | None] | None = None

    def match(self, text: str) -> re.Match[str] | None:
        """Find the values of the places in a text; None where it does not fit."""
        if self._mark not in text:  # which is quick to see
            return None
        if self._fits is None:
            self._fits = re.compile(self._expression(), re.DOTALL).fullmatch
        return self._fits(text)

    def _expression(self) -> str:
        """Write a regular expression; what is open ends where what follows it fits first, so it is quick."""
        parts = [_either_case(self._english[0][0])]
        for (_, name), (words, _) in pairwise(self._english):
            kind = self.kinds[name]
            if kind in _OPEN:
                parts.append("")
            parts[-1] += f"(?P<{name}>{KINDS[kind]}){re.escape(words)}"
        *inner, last = parts
        return "".join(f"(?>{part})" for part in inner) + last


class Phrasebook:
    """Japanese by English.

    A phrase may contain named places, such as ``{n}`` and ``{n2}`` for two numbers. The name without its digits is
    a key of `KINDS`, which defines the text that fits there. If the text in the place of a text, a client or a
    number of times is a phrase, it is translated as well. A clause must be a phrase, or the whole does not fit.

    What is no phrase is taken apart at semicolons, colons and commas, and at a full stop, which may come with a
    capital letter. What is not known even then is left as it is.
    """

    def __init__(self, phrases: Mapping[str, str]) -> None:
        """Take the phrases; of those that fit, the one is taken that leaves least open.

        Raises:
            KeyError: the Japanese has a place that the English lacks.
        """
        self._whole = {english: each for english, each in phrases.items() if not _PLACE.search(english)}
        patterns = (_Pattern(*each) for each in phrases.items() if each[0] not in self._whole)
        self._patterns = sorted(patterns, key=lambda each: (-each.words, each.open))

    def japanese(self, english: str) -> str:
        """Return a sentence in Japanese; as it is where it is no phrase."""
        return english if len(english) > LONGEST else _Reading(self._whole, self._patterns).put(english)


class _Reading:
    """One sentence being read: what is known of its parts is not looked for twice."""

    def __init__(self, whole: Mapping[str, str], patterns: list[_Pattern]) -> None:
        self._whole = whole
        self._patterns = patterns
        self._known: dict[str, str | None] = {}
        self._depth = 0
        self._looks = _MAX_LOOKS

    def put(self, text: str) -> str:
        """Return a text in Japanese, as far as it is known."""
        known = self.known(text)
        if known is not None:
            return known
        for joint, ours in (*_JOINTS.items(), (", ", "、")):
            left, found, right = text.partition(joint)
            if found and left and right and self._depth < _DEEPEST:
                parts = [self._below(self.put, part) for part in (left, right)]
                if parts != [left, right]:
                    return (joint if left == parts[0] or right == parts[1] else ours).join(parts)
        return text

    def known(self, text: str) -> str | None:
        """Return a text in Japanese if it is known from end to end."""
        if text not in self._known:
            found = self._one(text)
            if found is None and self._depth < _DEEPEST:
                found = self._below(self._in_parts, text)
            self._known[text] = found
        return self._known[text]

    def _one(self, text: str) -> str | None:
        """Return a text in Japanese that is a phrase without places."""
        return self._whole.get(text) or self._whole.get(_as_inside(text))

    def _in_parts(self, text: str) -> str | None:
        if text.endswith("."):
            inner = self.known(text[:-1]) or self.known(_as_inside(text[:-1]))
            if inner:
                return f"{inner}。"
        for left, joint, right in _splits(text):
            first = self._simple(left)
            rest = None if first is None else self.known(right)
            if rest is not None:
                return f"{first}{joint}{rest}"
        return self._simple(text)

    def _simple(self, text: str) -> str | None:
        """Return a text in Japanese that is one phrase."""
        whole = self._one(text)
        if whole is not None:
            return whole
        if not self._looks:
            return None
        self._looks -= 1
        found = (self._filled(pattern, text) for pattern in self._patterns)
        return next((each for each in found if each is not None), None)

    def _filled(self, pattern: _Pattern, text: str) -> str | None:
        match = pattern.match(text)
        if match is None:
            return None
        made, is_name = "", False
        for words, name in pattern.japanese:
            kind = pattern.kinds.get(name, "")
            value = self._value(kind, match[name]) if name else ""
            if value is None:
                return None
            made = made + words if is_name else _joined(made, words)
            is_name = kind in _KEPT  # around which nothing is touched
            made = made + value if is_name else _joined(made, value)
        return made

    def _value(self, kind: str, found: str) -> str | None:
        """Return what stands in a place in Japanese; None where it should be known and is not."""
        if kind in _KEPT:
            return found
        known = self._below(self.known if kind == "clause" else self.put, found)
        return self._below(self.put, _as_inside(found)) if kind == "client" else known

    def _below(self, put: Callable[[str], T], text: str) -> T:
        """Look at a part of a text."""
        self._depth += 1
        try:
            return put(text)
        finally:
            self._depth -= 1


def _splits(text: str) -> Iterator[tuple[str, str, str]]:
    """Yield the ways to take a text for two clauses, with what stands between them in Japanese."""
    for match in islice(_JOINT.finditer(text), _MAX_JOINTS):
        yield text[: match.start()], _JOINTS[match.group()], text[match.end() :]


def _taken_apart(phrase: str) -> tuple[tuple[str, str], ...]:
    """Return words, each with the name of the place behind them, "" at the end."""
    pieces = [*_PLACE.split(phrase), ""]
    return tuple(zip(pieces[::2], pieces[1::2], strict=True))


def _joined(left: str, right: str) -> str:
    """Put pieces one behind the other; between two Japanese ones there is no space."""
    if left.endswith(" ") and _WIDE.match(right) and _WIDE.match(left[-2:-1]):
        return left[:-1] + right
    if right.startswith(" ") and _WIDE.match(left[-1:]) and _WIDE.match(right[1:2]):
        return left + right[1:]
    return left + right


def _as_inside(text: str) -> str:
    """Write what begins a sentence as it is written inside one."""
    return f"{text[:1].lower()}{text[1:]}"


def _either_case(word: str) -> str:
    """Write a regular expression for a word that may begin a sentence."""
    first = word[:1]
    return f"[{first}{first.upper()}]{re.escape(word[1:])}" if first.islower() else re.escape(word)
