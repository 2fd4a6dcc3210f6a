"""Labels: every one in both languages, none written in place."""

from __future__ import annotations

import ast
import importlib
import pkgutil
import re
import string
from collections.abc import Iterator
from pathlib import Path

import pytest

import bcapscope.tui
from bcapscope.tui import words
from bcapscope.tui.words import CATALOGUE, Language, language_of, say, speak

(_ROOT,) = map(Path, bcapscope.tui.__path__)
SOURCES = sorted(path for path in _ROOT.rglob("*.py") if path.parent.name != "words")
LABELS = {"Static": 0, "Label": 0, "Button": 0, "notify": 0, "show_message": 0, "Prompt": 0}
"""Calls whose first argument people read."""

_WORD = re.compile(r"(^|\s)[^\W\d_]{2,}[.:…]?(\s|$)")
NAMED = {"placeholder", "border_title", "border_subtitle", "tooltip", "title"}


def places(text: str) -> set[str]:
    return {name for _, name, _, _ in string.Formatter().parse(text) if name is not None}


@pytest.mark.parametrize("key", sorted(CATALOGUE))
def test_both_languages_say_the_same(key: str) -> None:
    english, japanese = CATALOGUE[key]
    assert bool(english) == bool(japanese)
    assert places(english) == places(japanese)


def test_keys_are_there_once() -> None:
    names = [module.name for module in pkgutil.iter_modules(words.__path__, f"{words.__name__}.")]
    assert len(names) >= 4
    assert sum(len(getattr(importlib.import_module(name), "WORDS", ())) for name in names) == len(CATALOGUE)


def _letters(node: ast.expr) -> bool:
    """Tell whether an expression is a literal with a word in it; `Timeout=300` is b-CAP in any language."""
    if isinstance(node, ast.JoinedStr):
        return any(_letters(part) for part in node.values)
    return isinstance(node, ast.Constant) and isinstance(node.value, str) and bool(_WORD.search(node.value))


def _name(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def _written_in_place(tree: ast.AST) -> Iterator[ast.expr]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            index = LABELS.get(_name(node))
            if index is not None and len(node.args) > index and _letters(node.args[index]):
                yield node.args[index]
            if _name(node) == "Binding":
                tips = [each.value for each in node.keywords if each.arg == "tooltip"]
                for each in (*node.args[2:3], *tips):
                    if isinstance(each, ast.Constant) and each.value and each.value not in CATALOGUE:
                        yield each
            else:
                yield from (
                    each.value for each in node.keywords if each.arg in NAMED and _letters(each.value)
                )
        if isinstance(node, ast.Assign):
            names = [each.attr for each in node.targets if isinstance(each, ast.Attribute)]
            if set(names) & NAMED and _letters(node.value):
                yield node.value


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(_ROOT)))
def test_no_label_is_written_in_place(path: Path) -> None:
    tree = ast.parse(path.read_text())
    assert [ast.unparse(each) for each in _written_in_place(tree)] == []


def _constants() -> set[str]:
    found = set()
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.add(node.value)
            if isinstance(node, ast.JoinedStr) and isinstance(node.values[0], ast.Constant):
                prefix = str(node.values[0].value)
                found |= {key for key in CATALOGUE if key.startswith(prefix) and prefix}
    return found


def test_every_label_is_used() -> None:
    assert set(CATALOGUE) - _constants() == set()


@pytest.mark.parametrize(
    ("environment", "language"),
    [
        ({}, Language.ENGLISH),
        ({"LANG": "ja_JP.UTF-8"}, Language.JAPANESE),
        ({"LANG": "ja_JP.UTF-8", "LC_ALL": "C"}, Language.ENGLISH),
        ({"LANG": "de_DE.UTF-8", "LC_MESSAGES": "ja_JP"}, Language.JAPANESE),
        ({"LANG": "", "LC_ALL": ""}, Language.ENGLISH),
    ],
)
def test_the_environment_chooses(environment: dict[str, str], language: Language) -> None:
    assert language_of(environment) is language


def test_what_is_spoken_changes() -> None:
    speak(Language.JAPANESE)
    assert say("shell.quit") == "終了"
    assert say("traffic.lost", count=3) == "3 パケット欠落"
    speak(Language.ENGLISH)
    assert say("shell.quit") == "Quit"


def test_values_are_never_taken_for_places() -> None:
    assert say("traffic.trouble", reason="{0} {x}") == "Reading ended: {0} {x}"
