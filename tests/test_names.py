"""Names mean one thing in the whole package."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "bcapscope"

SAME_MEANING = {
    "call": "the command, and the module of the class Call",
    "proxy": "the command and the room",
    "replay": "the command and the room",
    "simulator": "the room and the module of the class Simulator",
    "slave": "the command, and the room of what it shows",
    "tui": "the command and the room",
    "wireshark": "the command and the room",
    "variant": "the module, and its former place, which warns whoever imports it",
}
"""Base names of modules that may occur twice, and why."""

VANISHING = PACKAGE / "tui" / "words"
"""Its modules are named for the rooms whose sentences they translate."""


def modules() -> list[Path]:
    """List all modules with a name of their own."""
    found = [path for path in PACKAGE.rglob("*.py") if path.stem not in ("__init__", "__main__")]
    return [path for path in found if VANISHING not in path.parents]


def packages() -> list[Path]:
    """List all folders of modules."""
    return [path.parent for path in PACKAGE.rglob("__init__.py") if path.parent != PACKAGE]


def test_no_public_class_name_occurs_twice() -> None:
    places = defaultdict(list)
    for path in modules():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(str(path.relative_to(PACKAGE)))
    assert len(places) > 500
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


def test_no_module_name_occurs_twice_with_another_meaning() -> None:
    places = defaultdict(list)
    for path in (*modules(), *packages()):
        places[path.stem].append(str(path.relative_to(PACKAGE)))
    several = {name: where for name, where in places.items() if len(where) > 1}
    assert {name: where for name, where in several.items() if name not in SAME_MEANING} == {}
