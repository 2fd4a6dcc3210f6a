"""Labels: none is written in place."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import bcapscope.tui
from bcapscope.messages import Language
from bcapscope.messages.message import has_message
from bcapscope.player.play_session import AGAIN, CLEAR, NO, YES
from bcapscope.tui.reader_language import label, set_language

(_ROOT,) = map(Path, bcapscope.tui.__path__)
SOURCES = sorted(_ROOT.rglob("*.py"))
LABELS = {"Static": 0, "Label": 0, "Button": 0, "notify": 0, "show_message": 0, "Prompt": 0}
"""Calls whose first argument people read."""

_WORD = re.compile(r"(^|\s)[^\W\d_]{2,}[.:…]?(\s|$)")
NAMED = {"placeholder", "border_title", "border_subtitle", "tooltip", "title"}


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
                    if isinstance(each, ast.Constant) and each.value and not has_message(str(each.value)):
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


@pytest.mark.parametrize("choice", [YES, NO, CLEAR, AGAIN])
def test_each_choice_of_the_player_has_a_label(choice: str) -> None:
    assert has_message(f"tester.answer.{choice}")


def test_what_is_spoken_changes() -> None:
    set_language(Language.JAPANESE)
    assert label("shell.quit") == "終了"
    assert label("traffic.lost", count=3) == "3 パケット欠落"
    set_language(Language.ENGLISH)
    assert label("shell.quit") == "Quit"
