"""The catalogue: every message in both languages with the same places, and none that nobody uses."""

from __future__ import annotations

import ast
import gettext
import re
import string
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from babel.messages import Catalog
from babel.messages.catalog import Message as Entry
from babel.messages.pofile import read_po

import bcapscope
from bcapscope.messages import Language
from bcapscope.messages import places as places_module
from bcapscope.messages.message import Place

PACKAGE = Path(bcapscope.__file__).parent
LOCALE = PACKAGE / "messages" / "locale"
SOURCES = sorted(PACKAGE.rglob("*.py"))
KINDS = [each for each in vars(places_module).values() if isinstance(each, type) and issubclass(each, Place)]
TYPES = {kind.type_name for kind in KINDS if hasattr(kind, "type_name")} | {"message", ""}
MAKERS = {"Message": (), "words": (), "label": (), "reason_from_call": ("call", "at")}
"""What makes a message from a literal id, and the places that it adds."""

_CODES = re.compile(r"\b(?:[0-9A-F]{8}|842040xx|0x[0-9A-Fn]+|slv\w+)\b")
"""What a translation neither loses nor changes: result codes, modes, and slave-mode commands."""


@cache
def catalogue(language: Language) -> Catalog:
    with (LOCALE / language / "LC_MESSAGES" / "bcapscope.po").open("rb") as source:
        return read_po(source, locale=language.value)


@cache
def entries(language: Language) -> dict[str, Entry]:
    return {
        each.id if isinstance(each.id, str) else each.id[0]: each for each in catalogue(language) if each.id
    }


def texts(entry: Entry) -> tuple[str, ...]:
    return (entry.string,) if isinstance(entry.string, str) else tuple(entry.string or ())


def places(text: str) -> set[tuple[str, str]]:
    return {(name, spec or "") for _, name, spec, _ in string.Formatter().parse(text) if name is not None}


ENGLISH, JAPANESE = entries(Language.ENGLISH), entries(Language.JAPANESE)


@pytest.mark.parametrize("key", sorted(ENGLISH))
def test_both_languages_have_the_same_message(key: str) -> None:
    english, japanese = ENGLISH[key], JAPANESE[key]
    assert all(texts(english))
    assert all(texts(japanese))
    assert english.pluralizable == japanese.pluralizable
    ours = set().union(*map(places, texts(english)))
    theirs = set().union(*map(places, texts(japanese)))
    assert {(name, kind.lower()) for name, kind in ours} == {(name, kind.lower()) for name, kind in theirs}
    assert {kind.lower() for _, kind in ours | theirs} <= TYPES
    assert set(_CODES.findall(texts(english)[-1])) <= set(_CODES.findall(texts(japanese)[-1]))


def test_messages_only_in_japanese_have_their_english_in_a_table() -> None:
    assert {name for name in JAPANESE if "table" not in JAPANESE[name].user_comments} == set(ENGLISH)


@pytest.mark.parametrize("language", Language)
def test_the_compiled_catalogue_is_up_to_date(language: Language) -> None:
    with (LOCALE / language / "LC_MESSAGES" / "bcapscope.mo").open("rb") as source:
        compiled = gettext.GNUTranslations(source)
    for name, entry in entries(language).items():
        if entry.pluralizable:
            found = [compiled.ngettext(name, f"{name}.plural", number) for number in (1, 2)]
            assert found == [texts(entry)[0], texts(entry)[-1]]
        else:
            assert compiled.gettext(name) == entry.string


class _Use:
    """A place in the source that makes a message from a literal id."""

    def __init__(self, path: Path, call: ast.Call, name: str) -> None:
        self.where = f"{path.relative_to(PACKAGE)}:{call.lineno}"
        self.name = name
        given = [*MAKERS[_maker(call)], *(each.arg for each in call.keywords)]
        self.given = None if None in given else {each for each in given if each is not None}


def uses() -> Iterator[_Use]:
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and node.args and _maker(node) in MAKERS:
                first = node.args[0]
                if isinstance(first, ast.Constant) and isinstance(first.value, str):
                    yield _Use(path, node, first.value)


def _maker(call: ast.Call) -> str:
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    return str(name).lstrip("_")


def test_each_message_that_is_made_is_in_the_catalogue_with_its_places() -> None:
    wrong = []
    for use in uses():
        entry = ENGLISH.get(use.name)
        if entry is None:
            wrong.append(f"{use.where}: no message {use.name}")
        elif use.given is not None:
            wanted = {place for text in texts(entry) for place, _ in places(text)}
            if not wanted <= use.given:
                wrong.append(f"{use.where}: {use.name} lacks {sorted(wanted - use.given)}")
    assert wrong == []


def _strings_and_patterns() -> tuple[set[str], list[re.Pattern[str]]]:
    """Return the string constants of the package, and patterns of its f-strings that could be ids.

    In templates, ``"start." ~ rest`` is the counterpart of an f-string.
    """
    constants, patterns = set(), set()
    for path in PACKAGE.rglob("*.html"):
        for constant, joined in re.findall(r"""["']([a-z][\w.-]*)["']( ~)?""", path.read_text("utf-8")):
            constants.add(constant)
            if joined and constant[-1] in ".-":
                patterns.add(re.escape(constant) + r"[\w.-]*")
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                constants.add(node.value)
            if isinstance(node, ast.JoinedStr):
                parts = [
                    re.escape(str(each.value)) if isinstance(each, ast.Constant) else r"[\w.-]*"
                    for each in node.values
                ]
                if re.match(r"[a-z]+(\\-[a-z]+)*\\\.", parts[0]):
                    patterns.add("".join(parts))
    return constants, [re.compile(each) for each in patterns]


def test_every_message_is_used() -> None:
    constants, patterns = _strings_and_patterns()
    count_units = {f"count.{each}" for each in constants}
    unused = {
        name
        for name in set(ENGLISH) - constants - count_units
        if name.removesuffix(".tip") not in constants  # the tip of a key binding
        if not any(pattern.fullmatch(name) for pattern in patterns)
    }
    assert unused == set()
