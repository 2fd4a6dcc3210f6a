"""Check arguments that must be one of a few words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from bcapscope.errors import InputError
from bcapscope.messages import Message

T = TypeVar("T")


def choose(word: str, choices: Mapping[str, T]) -> T:
    """Return the value of a word in `choices`.

    Raises:
        InputError: The word is not one of the choices.
    """
    if word not in choices:
        values = ", ".join(map(repr, choices))
        raise InputError(Message("document.none-of", value=repr(word), values=values))
    return choices[word]
