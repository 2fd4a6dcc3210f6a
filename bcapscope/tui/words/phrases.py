"""Sentences that rooms below say, which know English only, put into Japanese."""

from __future__ import annotations

import re
from collections.abc import Mapping

LONGEST = 600
"""Characters of a sentence that is looked up: what is longer is no sentence of ours."""

_DEEPEST = 6
"""Phrases within phrases."""

_PLACES = {
    "{}": r"(.+?)",
    "{#}": r"([-+]?[\d.]+(?:e[-+]?\d+)?)",
    "{J}": r"([A-Z]\w*(?:, [A-Z]\w*)*)",
}
_PLACE = re.compile(r"\{[#J]?\}")


class Phrasebook:
    """Japanese by English.

    A phrase may have places, written in English ``{}``, ``{#}`` where only a number can stand, ``{J}`` where only
    names such as ``J1, J2`` can; in Japanese ``{0}``, ``{1}`` by their order in English. What stands in a place is
    put into Japanese as well, if it is a phrase.
    """

    def __init__(self, phrases: Mapping[str, str]) -> None:
        """Take the phrases; of those that fit, the one is taken that leaves least open."""
        self._whole = {english: each for english, each in phrases.items() if not _PLACE.search(english)}
        with_places = sorted(
            (english for english in phrases if english not in self._whole),
            key=lambda english: (-len(_PLACE.sub("", english)), english.count("{}")),
        )
        self._patterns = [(_pattern(english), phrases[english]) for english in with_places]

    def japanese(self, english: str) -> str:
        """Return a sentence in Japanese; as it is where it is no phrase."""
        return self._put(english, _DEEPEST) if len(english) <= LONGEST else english

    def _put(self, text: str, depth: int) -> str:
        found = self._whole.get(text)
        if found is not None or not depth:
            return text if found is None else found
        for pattern, japanese in self._patterns:
            match = pattern.fullmatch(text)
            if match:
                return japanese.format(*(self._put(value, depth - 1) for value in match.groups()))
        return text


def _pattern(english: str) -> re.Pattern[str]:
    words = map(re.escape, _PLACE.split(english))
    places = (_PLACES[place] for place in _PLACE.findall(english))
    parts = [next(words)]
    for place, word in zip(places, words, strict=True):
        parts += (place, word)
    return re.compile("".join(parts), re.DOTALL)
