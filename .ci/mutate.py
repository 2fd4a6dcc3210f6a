#!/usr/bin/env python3
"""Change the package in small ways, and list the changes that no test notices.

Usage: .ci/mutate.py [COUNT [SEED]]    COUNT changes (100), drawn by SEED (0)

Each change is made in a copy of the project. It affects one comparison, operator, number, `not`, call, return
value or slice. The tests of the module run first, then those of its package, then all others. Look at each
survivor: it lacks a test, or the change makes no difference. Exits with 1 if 3 % or more survive.
"""

from __future__ import annotations

import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
PACKAGES = ("protocol", "traffic", "proxy", "faults")
SURVIVING_SHARE = 0.03
SECONDS = 1200  # a change that makes tests hang is noticed
NOT_COPIED = shutil.ignore_patterns(".venv", ".git", ".hypothesis", "__pycache__", ".*_cache")

PAIRS = [
    (ast.Lt, ast.LtE), (ast.Gt, ast.GtE), (ast.Eq, ast.NotEq), (ast.Is, ast.IsNot), (ast.In, ast.NotIn),
    (ast.And, ast.Or), (ast.Add, ast.Sub), (ast.Mult, ast.FloorDiv), (ast.BitAnd, ast.BitOr),
    (ast.LShift, ast.RShift), (ast.Break, ast.Continue),
]  # fmt: skip
SWAPPED = {**dict(PAIRS), **{second: first for first, second in PAIRS}}
NOT_CHANGED = {"annotation", "returns", "decorator_list", "keywords"}
"""Fields of functions and classes whose changes no test can notice, or that mypy notices."""


def changes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what may replace a node."""
    match node:
        case ast.Break() | ast.Continue():
            yield SWAPPED[type(node)]()
        case ast.Constant(value=bool()):
            yield ast.Constant(not node.value)
        case ast.Constant(value=int() | float()):
            yield ast.Constant(node.value + 1)
            yield ast.Constant(node.value - 1)
        case ast.UnaryOp(op=ast.Not()):
            yield node.operand
        case ast.Expr(value=ast.Call()):
            yield ast.Pass()
        case ast.Return(value=ast.expr()) if not isinstance(node.value, ast.Constant):
            yield ast.Return(ast.Constant(None))
        case ast.Slice(lower=ast.expr()):
            yield with_field(node, "lower", None)
        case ast.Slice(upper=ast.expr()):
            yield with_field(node, "upper", None)
        case ast.Compare(ops=[operator]):
            yield with_field(node, "ops", [SWAPPED[type(operator)]()])
        case ast.BoolOp() | ast.BinOp() | ast.AugAssign() if type(node.op) in SWAPPED:
            yield with_field(node, "op", SWAPPED[type(node.op)]())


def with_field(node: ast.AST, name: str, value: object) -> ast.AST:
    changed = copy.copy(node)
    setattr(changed, name, value)
    return changed


def changeable(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes inside a node that have changes. Texts for people are left out."""
    if isinstance(node, ast.JoinedStr) or (isinstance(node, ast.FunctionDef) and node.name == "__repr__"):
        return
    if any(changes(node)):
        yield node
    for name, value in ast.iter_fields(node):
        if name not in NOT_CHANGED or isinstance(node, ast.Call):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from changeable(child)


class Replacement(ast.NodeTransformer):
    """Replaces one node of a tree."""

    def __init__(self, old: ast.AST, new: ast.AST) -> None:
        self.old, self.new = old, new

    def visit(self, node: ast.AST) -> ast.AST:
        return self.new if node is self.old else self.generic_visit(node)


def draw_change(rng: random.Random, source: str) -> tuple[str, str] | None:
    """Return the source after one change, and the change as text; None if nothing in it can be changed."""
    module = ast.parse(source)
    found = list(changeable(module))
    if not found:
        return None
    old = rng.choice(found)
    new = rng.choice(list(changes(old)))
    shown = [ast.unparse(ast.fix_missing_locations(node)).partition("\n")[0] for node in (old, new)]
    changed = ast.fix_missing_locations(Replacement(old, new).visit(module))
    return ast.unparse(changed), f"{getattr(old, 'lineno', '')}: {shown[0]}  ->  {shown[1]}"


def is_noticed(tree: Path, path: Path) -> bool:
    """Return whether a test fails. First try the module's own tests, then those of its package, then all."""
    environment = {**os.environ, "PYTHONPATH": str(tree)}  # for the programs that tests start
    folder = tree / "tests" / path.relative_to(tree / "bcapscope").parts[0]
    own = [*folder.rglob(f"test_{path.stem}.py")]
    for tests in ([*own, "-n0"] if own else [], [folder, tree / "tests" / "messages"], [tree / "tests"]):
        if not tests:
            continue
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *map(str, tests)]
        try:
            subprocess.run(
                command, cwd=tree, env=environment, capture_output=True, timeout=SECONDS, check=True
            )
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired):
            return True
    return False


def main(count: int = 100, seed: int = 0) -> int:
    rng, made, survived = random.Random(seed), 0, 0
    with tempfile.TemporaryDirectory() as scratch:
        tree = Path(scratch, "project")
        shutil.copytree(PROJECT, tree, ignore=NOT_COPIED)
        paths = sorted(path for name in PACKAGES for path in (tree / "bcapscope" / name).rglob("*.py"))
        lines = [path.read_text("utf-8").count("\n") for path in paths]
        if is_noticed(tree, paths[0]):
            print("the tests fail or hang without a change")
            return 1
        while made < count:
            (path,) = rng.choices(paths, lines)
            source = path.read_text("utf-8")
            change = draw_change(rng, source)
            if change is None:
                continue
            path.write_text(change[0], "utf-8")
            made += 1
            if not is_noticed(tree, path):
                survived += 1
                print(f"survived: {path.relative_to(tree)}:{change[1]}", flush=True)
            path.write_text(source, "utf-8")
            # examples that failed only because of this change may take very long without it
            shutil.rmtree(tree / ".hypothesis", ignore_errors=True)
    print(f"{survived} of {count} changes survived")
    return int(survived >= count * SURVIVING_SHARE)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
