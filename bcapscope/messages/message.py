"""Sentences as data, which are converted to text in the reader's language."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from enum import StrEnum
from functools import cache, lru_cache
from string import Formatter
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar, TypeAlias, Union

if TYPE_CHECKING:
    from gettext import GNUTranslations


class Language(StrEnum):
    ENGLISH = "en"
    JAPANESE = "ja"


def language_of(environment: Mapping[str, str]) -> Language:
    """Return the language of the first set variable of LC_ALL, LC_MESSAGES and LANG. Default: English."""
    names = (environment.get(name, "") for name in ("LC_ALL", "LC_MESSAGES", "LANG"))
    name = next(filter(None, names), "")
    return Language.JAPANESE if name.casefold().startswith("ja") else Language.ENGLISH


Json: TypeAlias = "str | int | float | list[Json] | dict[str, Json] | None"


class Place(ABC):
    """A value of a certain type, which fills a placeholder of a sentence.

    In a template, the type of the value follows the name of the placeholder: ``{latency:duration}``.

    Attributes have the names and the order of the constructor's arguments, and never change. The subclasses
    are not dataclasses, because defining 17 dataclasses takes 7 ms at the start of every command.
    """

    type_name: ClassVar[str]

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and vars(other) == vars(self)

    def __hash__(self) -> int:
        return hash(tuple(vars(self).values()))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(map(repr, vars(self).values()))})"

    @abstractmethod
    def text(self, words: MessageFormatter) -> str:
        """Return the value as text. Strings from the wire are not escaped."""

    def to_json(self) -> Json:
        return {"type": self.type_name, **vars(self)}


PlaceValue: TypeAlias = Union["Message", Place, str, int, float]


class Message:
    """A sentence as data: an id of the catalogue, and a value for each placeholder. A message is immutable.

    ``str()`` returns the English sentence, so that tracebacks show this sentence. `english` is the
    English text if the catalogue lacks this text, for example a text of a protocol table; None otherwise.
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
        """Return a message with the English text `english`. The English catalogue lacks this text, but the
        catalogues of other languages may have a translation.
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
        return ENGLISH_WORDS.text(self)


def _restore(id: str, places: dict[str, PlaceValue], english: str | None) -> Message:
    return Message(id, **places) if english is None else Message.from_table(id, english, **places)


def foreign_text(text: str) -> Message:
    """Return a message with a text of another program or library. bcapscope does not translate this text."""
    return Message.from_table("text", text)


class MessageFormatter:
    """Converts messages to sentences in one language.

    Sentences show times relative to `start`, in ns since 1970. With `only_client`, sentences leave out the
    address of the client. `find_frame` returns the capture and the packet number of a frame, or None for an
    unknown frame. If `find_frame` is None, sentences show only the numbers of frames.
    """

    def __init__(
        self,
        language: Language = Language.ENGLISH,
        start: int = 0,
        only_client: bool = True,
        find_frame: Callable[[int], tuple[str, int] | None] | None = None,
    ) -> None:
        self.language = language
        self.start = start
        self.only_client = only_client
        self.find_frame = find_frame

    def __call__(self, id: str, /, **places: PlaceValue) -> str:
        return self.text(Message(id, **places))

    def for_report(self, start: int, only_client: bool) -> MessageFormatter:
        return MessageFormatter(self.language, start, only_client, self.find_frame)

    def for_captures(self, find_frame: Callable[[int], tuple[str, int] | None]) -> MessageFormatter:
        """Return a formatter that also names each frame's capture and packet."""
        return MessageFormatter(self.language, self.start, self.only_client, find_frame)

    def text(self, message: Message) -> str:
        """Return a message as text. For an unknown id, return the id and the values. Raises no exception."""
        template = _template(self.language, message.id)
        if template is None:
            return self._without_template(message)
        return self._filled(template, message)

    def plural(self, id: str, number: int) -> str:
        """Return the singular or plural text of `id`, with `number` in place of ``{n}``."""
        translations = _translations(self.language)
        template = translations.ngettext(id, f"{id}.plural", number)
        if template.startswith(id):
            template = _translations(Language.ENGLISH).ngettext(id, f"{id}.plural", number)
        return template.replace("{n}", str(number))

    def sentences(self, texts: Iterable[str]) -> str:
        return ("" if self.language is Language.JAPANESE else " ").join(filter(None, texts))

    def place_text(self, value: PlaceValue, type_name: str) -> str:
        """Return a value as text, which is capitalised if `type_name` begins with a capital letter."""
        if isinstance(value, Place):
            text = value.text(self)
        else:
            text = self.text(value) if isinstance(value, Message) else str(value)
        return text[:1].upper() + text[1:] if type_name[:1].isupper() else text

    def _filled(self, template: str, message: Message) -> str:
        """Fill the placeholders of a template. Remove the template's space between Japanese characters."""
        made = ""
        for literal, name, type_name in _parsed(template):
            needless = literal[:1] == " " and _is_japanese(made[-1:]) and _is_japanese(literal[1:2])
            made += literal[needless:]
            if name is not None:
                value = message.places.get(name)
                text = f"{{{name}}}" if value is None else self.place_text(value, type_name)
                needless = literal[-1:] == " " and _is_japanese(literal[-2:-1]) and _is_japanese(text[:1])
                made = made[: len(made) - needless] + text
        return made

    def _without_template(self, message: Message) -> str:
        if message.english is not None:
            return message.english
        places = ", ".join(f"{name}={self.place_text(value, '')}" for name, value in message.places.items())
        return f"{message.id} ({places})" if places else message.id


def _is_japanese(character: str) -> bool:
    return "\u3001" <= character <= "\u9fff" or "\uff01" <= character <= "\uff60"


ENGLISH_WORDS = MessageFormatter()


def message_params(message: Message) -> dict[str, Json]:
    return {name: _json(value) for name, value in message.places.items()}


def _json(value: PlaceValue) -> Json:
    if isinstance(value, Message):
        return {"type": "message", "id": value.id, "params": message_params(value), "text": str(value)}
    return value.to_json() if isinstance(value, Place) else value


@cache
def _translations(language: Language) -> GNUTranslations:
    import gettext  # noqa: PLC0415 - keeps `bcapscope --help` fast

    path = os.path.join(os.path.dirname(__file__), "locale", language, "LC_MESSAGES", "bcapscope.mo")
    with open(path, "rb") as compiled:
        return gettext.GNUTranslations(compiled)


def has_message(id: str) -> bool:
    return _template(Language.ENGLISH, id) is not None


@lru_cache(4096)
def _template(language: Language, id: str) -> str | None:
    """Return the template of an id, in English if `language` lacks the id; None if the id is unknown."""
    found = _translations(language).gettext(id)
    if id and found != id:  # for an empty id, gettext returns the header of the catalogue
        return found
    if language is Language.ENGLISH:
        return None
    return _template(Language.ENGLISH, id)


@lru_cache(4096)
def _parsed(template: str) -> tuple[tuple[str, str | None, str], ...]:
    """Split a template into literal texts, each with the name and type of the placeholder that follows it."""
    return tuple((literal, name, spec or "") for literal, name, spec, _ in Formatter().parse(template))
