"""Every behaviour that can be told from the code is in the table, and nothing else of its kind."""

from __future__ import annotations

import ast
from dataclasses import fields
from pathlib import Path

from bcapscope import simulator
from bcapscope.simulator.behaviours import Certainty, read_behaviours
from bcapscope.simulator.profile import Profile

_ENDS = ("RefusedError", "CallResult", "raise_error", "refuse", "reply", "stop", "_check_width")
"""What is called with a result."""

BEHAVIOURS = read_behaviours()
NAMES = [behaviour.name for behaviour in BEHAVIOURS]


def _results() -> set[str]:
    """Collect the constants that calls end in."""
    found = set()
    for path in Path(simulator.__path__[0]).glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] in _ENDS:
                names = (each for argument in node.args for each in ast.walk(argument))
                found |= {name for each in names if (name := _name(each)).isupper()}
    return found - {"S_OK", "DONE"}


def _name(node: ast.AST) -> str:
    """Return the last part of a name such as `RefusalCode.BAD_INDEX`; "" for other nodes."""
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


def test_each_field_of_a_profile_has_its_source() -> None:
    assert {field.name for field in fields(Profile)} - {"name", "title"} <= set(NAMES)


def test_each_result_has_its_source() -> None:
    assert len(_results()) > 25
    assert _results() <= set(NAMES)


def test_no_behaviour_is_told_twice_or_without_a_source() -> None:
    assert len({(behaviour.name, behaviour.text) for behaviour in BEHAVIOURS}) == len(BEHAVIOURS)
    assert all(behaviour.text and behaviour.source for behaviour in BEHAVIOURS)
    assert {behaviour.certainty for behaviour in BEHAVIOURS} == set(Certainty)


def test_what_no_source_says_is_assumed() -> None:
    for behaviour in BEHAVIOURS:
        if behaviour.source in ("no source says", "bcapscope's own choice", "bcapscope's own limit"):
            assert behaviour.certainty is Certainty.ASSUMED, behaviour


def test_no_result_is_told_of_that_is_not_in_the_code() -> None:
    paths = [path for path in Path(simulator.__path__[0]).glob("*.py") if path.name != "behaviours.py"]
    code = "\n".join(path.read_text() for path in paths)
    assert [name for name in NAMES if name.isupper() and name not in code] == []
