"""A sentence as data."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TypeAlias, Union

from bcapscope.messages.places import Place

PlaceValue: TypeAlias = Union["Message", Place, str, int, float]
"""Value of a place: a typed one, another message, or plain text or a plain number."""


class Message:
    """An id of the catalogue, and a value for each place of its sentence. Immutable; compared by value.

    ``str()`` gives the English sentence, so an exception that holds a message reads well anywhere.

    Attributes:
        id: Key in the catalogue, such as `finding.no-reply`.
        places: Values by the name of their place.
        english: English text of messages whose words come from a table of the protocol; None if the
            catalogue has them.
    """

    __slots__ = ("english", "id", "places")

    id: str
    places: Mapping[str, PlaceValue]
    english: str | None

    def __init__(self, id: str, /, **places: PlaceValue) -> None:
        object.__setattr__(self, "id", id)
        object.__setattr__(self, "places", MappingProxyType(places))
        object.__setattr__(self, "english", None)

    @classmethod
    def from_table(cls, id: str, english: str, /, **places: PlaceValue) -> Message:
        """Return a message whose English is in a table, such as the meaning of a result code.

        The catalogue holds its translations only.
        """
        message = cls(id, **places)
        object.__setattr__(message, "english", english)
        return message

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"a message cannot be changed: {name}")

    def __reduce__(self) -> tuple[object, ...]:
        return _restore, (self.id, dict(self.places), self.english)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Message):
            return NotImplemented
        return (self.id, self.english, self.places) == (other.id, other.english, other.places)

    def __hash__(self) -> int:
        return hash((self.id, self.english, tuple(self.places.items())))

    def __repr__(self) -> str:
        places = "".join(f", {name}={value!r}" for name, value in self.places.items())
        return f"Message({self.id!r}{places})"

    def __str__(self) -> str:
        from bcapscope.messages.message_formatter import ENGLISH_WORDS  # noqa: PLC0415 - it formats messages

        return ENGLISH_WORDS.text(self)


def _restore(id: str, places: dict[str, PlaceValue], english: str | None) -> Message:
    return Message(id, **places) if english is None else Message.from_table(id, english, **places)
