"""English that is left: in a sentence for people, and in modules whose sentences a screen shows."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from types import ModuleType

from bcapscope.tui.words import PHRASES

_WORD = re.compile(r"(?<![\w.,'@|（(=/-])[a-z]{2,}(?![\w'=/([-])")
_TERMS = frozenset(("deg", "loss", "mm", "ms", "ppm", "rad", "reserved", "tcp", "udp", "us", "zlib"))
"""Units and words of the vendor's, the same in Japanese."""

_NAME = re.compile("「[^」]*」|x{60}…")
"""What is from the wire or a file."""

_SENTENCE = re.compile("[a-z]{2,} [a-z]{2,}")
_SAID = "\n".join(re.sub(r"\{\w+\}", "\n", english) for english in PHRASES)
_PART = re.compile(r"^[ /]m?s²?(?=[ ,])|\n|; |: |\b0x|\d+")
"""Between parts of a text that phrases have one by one: clauses, and what stands around a number."""


def left_over(japanese: str) -> list[str]:
    """List the English words in a sentence that should have none."""
    return [word for word in _WORD.findall(_NAME.sub("", japanese)) if word not in _TERMS]


def untold(module: ModuleType) -> list[str]:
    """List what the functions of a module can say and no phrase has; clauses of two words and more."""
    tree = ast.parse(inspect.getsource(module))
    return [text for text in _texts(tree) if text not in _SAID]


def _texts(tree: ast.AST) -> Iterator[str]:
    quiet = {id(part) for node in ast.walk(tree) for part in _never_said(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in quiet:
            yield from (text.removesuffix(".") for text in _PART.split(node.value) if _SENTENCE.search(text))


def _never_said(node: ast.AST) -> Iterator[ast.AST]:
    """Yield docstrings, and constants of a module that are data."""
    if isinstance(node, ast.Expr):
        yield node.value
    if isinstance(node, ast.Module):
        for statement in node.body:
            if not isinstance(statement, ast.FunctionDef | ast.ClassDef):
                yield from ast.walk(statement)
