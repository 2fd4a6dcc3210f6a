"""Sentences that rooms below say, which know English only, put into Japanese."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from types import MappingProxyType
from typing import NamedTuple, TypeVar

LONGEST = 2000
"""Characters of a sentence that is looked up: what is longer is no sentence of ours."""

_DEEPEST = 12
"""Phrases within phrases."""

_MOST_JOINTS = 24
"""Places at which a sentence is looked upon as two clauses; more have only lists of names."""

_JOINTS = MappingProxyType({"; ": "。", ": ": ": "})
"""What stands between clauses, in English and in Japanese."""

KINDS: Mapping[str, str] = MappingProxyType(
    {
        "axes": r"[A-Z]\w*(?:, [A-Z]\w*)*",
        "clause": r".+?",
        "client": r"[Yy]our client|[Cc]lient \S+(?: \((?:UDP|TCP)\))?",
        "code": r"0x[0-9A-F]+",
        "n": r"[-+]?[\d.]+(?:e[-+]?\d+)?",
        "name": r".+?",
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
_KEPT = frozenset(("axes", "code", "n", "name", "span", "time", "unit", "word"))
"""Kinds that are the same in Japanese; of a name from the wire or of a file no word is ever exchanged."""

_JOINT = re.compile("|".join(_JOINTS))
_PLACE = re.compile(r"\{([a-z]+\d*)\}")
_WIDE = re.compile("[\u3001-\u9fff\uff01-\uff60]")

T = TypeVar("T", str, str | None)


class _Pattern(NamedTuple):
    """A phrase with places.

    Attributes:
        mark: words that a text has where it fits; looking for them is quick.
        fits: finds the values of the places in a text.
        kinds: of the places, by their names.
        japanese: words, each with the name of the place behind them, "" at the end.
    """

    mark: str
    fits: Callable[[str], re.Match[str] | None]
    kinds: Mapping[str, str]
    japanese: tuple[tuple[str, str], ...]


class Phrasebook:
    """Japanese by English.

    A phrase may have places with names, such as ``{n}`` and ``{n2}`` for two numbers; a name without its digits is
    one of `KINDS` and tells what can stand there. What stands in the place of a text, a client or a number of
    times is put into Japanese as well, if it is a phrase. A clause has to be one, or the phrase does not fit.

    What is no phrase is taken apart at semicolons, colons and commas, and at a full stop, which may come with a
    capital letter. What is not known even then is left as it is.
    """

    def __init__(self, phrases: Mapping[str, str]) -> None:
        """Take the phrases; of those that fit, the one is taken that leaves least open.

        Raises:
            KeyError: a place has no known kind, or the Japanese has one that the English lacks.
        """
        self._whole = {english: each for english, each in phrases.items() if not _PLACE.search(english)}
        with_places = sorted(
            (english for english in phrases if english not in self._whole),
            key=lambda english: (-len(_PLACE.sub("", english)), _openness(english)),
        )
        self._patterns = [_pattern(english, phrases[english]) for english in with_places]

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

    def put(self, text: str) -> str:
        """Return a text in Japanese, as far as it is known."""
        known = self.known(text)
        if known is not None:
            return known
        for joint, ours in (*_JOINTS.items(), (", ", ", ")):
            left, found, right = text.partition(joint)
            if found and left and right and self._depth < _DEEPEST:
                parts = [self._below(self.put, part) for part in (left, right)]
                if parts != [left, right]:
                    return (joint if left == parts[0] or right == parts[1] else ours).join(parts)
        return text

    def known(self, text: str) -> str | None:
        """Return a text in Japanese if it is known from end to end."""
        if text not in self._known:
            found = self._whole.get(text)
            if found is None and self._depth < _DEEPEST:
                found = self._below(self._in_parts, text)
            self._known[text] = found
        return self._known[text]

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
        if text in self._whole:
            return self._whole[text]
        found = (self._filled(pattern, text) for pattern in self._patterns)
        return next((each for each in found if each is not None), None)

    def _filled(self, pattern: _Pattern, text: str) -> str | None:
        match = pattern.fits(text) if pattern.mark in text else None
        if match is None:
            return None
        made = ""
        for words, name in pattern.japanese:
            value = self._value(pattern.kinds[name], match[name]) if name else ""
            if value is None:
                return None
            made = _joined(_joined(made, words), value)
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
    for match in islice(_JOINT.finditer(text), _MOST_JOINTS):
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


def _openness(english: str) -> int:
    return sum(name.rstrip("0123456789") in _OPEN for name in _PLACE.findall(english))


def _pattern(english: str, japanese: str) -> _Pattern:
    """Make a pattern; what is open ends at the first place where what follows it fits, so that none takes long."""
    taken, ours = _taken_apart(english), _taken_apart(japanese)
    words, kinds = [each for each, _ in taken], {name: name.rstrip("0123456789") for _, name in taken if name}
    parts = [_either_case(words[0])]
    for (name, kind), word in zip(kinds.items(), words[1:], strict=True):
        if kind in _OPEN:
            parts.append("")
        parts[-1] += f"(?P<{name}>{KINDS[kind]}){re.escape(word)}"
    *inner, last = parts
    whole = "".join(f"(?>{part})" for part in inner) + last
    marks = (words[0][1:], *words[1:])
    fits = re.compile(whole, re.DOTALL).fullmatch
    return _Pattern(
        max(marks, key=len), fits, {name: kinds[name] for _, name in (*taken, *ours) if name}, ours
    )


def _either_case(word: str) -> str:
    """Write a regular expression for a word that may begin a sentence."""
    first = word[:1]
    return f"[{first}{first.upper()}]{re.escape(word[1:])}" if first.islower() else re.escape(word)
