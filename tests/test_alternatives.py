"""Types that are alternatives of one another never compare equal across types, as two NamedTuples would."""

from __future__ import annotations

import ast
import importlib
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

import bcapscope
from bcapscope.capture.hex_line import EndOffset, ProseText
from bcapscope.faults.fault import CloseMode
from bcapscope.faults.wire_message import CloseConnection
from bcapscope.faults.wire_message import SendBytes as SendMessage
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.retry.requester import (
    CallAnswered,
    CallExecuting,
    CallRefused,
    CallTimedOut,
    LateReply,
)
from bcapscope.proxy.policy import CloseAction, SendAction
from bcapscope.traffic.observation import Direction
from tests.faults.traffic import talk

MODULES = [each.name for each in pkgutil.walk_packages(bcapscope.__path__, "bcapscope.")]
REPLY = Frame(encode_frame(1, 0, 0))


def unions(source: str) -> Iterator[tuple[str, ...]]:
    """Give out the names that each union of types joins, such as `SendAction` and `CloseAction` of ``Send |
    Close``.
    """
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr):
            yield tuple(_members(node))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and " | " in node.value:
            yield tuple(part.strip() for part in node.value.split("|"))  # an annotation in quotes


def _members(union: ast.expr) -> Iterator[str]:
    if isinstance(union, ast.BinOp) and isinstance(union.op, ast.BitOr):
        yield from _members(union.left)
        yield from _members(union.right)
    else:
        yield ast.unparse(union)


def tuples(module: ModuleType, names: tuple[str, ...]) -> set[type]:
    """Return those types of a union, the members of its aliases included, that compare as tuples do."""
    found = [getattr(module, name, None) for name in names]
    types = [each for one in found for each in getattr(one, "__args__", (one,))]
    return {each for each in types if isinstance(each, type) and issubclass(each, tuple)}


def test_no_two_alternatives_compare_as_tuples() -> None:
    compared = {}
    for name in MODULES:
        module = importlib.import_module(name)
        assert module.__file__ is not None
        for names in unions(Path(module.__file__).read_text("utf-8")):
            if len(types := tuples(module, names)) > 1:
                compared[name] = types
    assert compared == {}


def test_the_unions_of_a_module_are_found() -> None:
    text = 'A = B | C | None\ndef f(x: D | E) -> "G | H": ...\n'
    assert {("B", "C", "None"), ("D", "E"), ("G", "H")} <= set(unions(text))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (CallAnswered(REPLY, ()), CallRefused(REPLY, ())),
        (CallExecuting(REPLY), CallTimedOut(())),
        (LateReply(REPLY, 1, 2), CallExecuting(REPLY)),
        (ProseText("00"), EndOffset("00")),
        (SendMessage(talk().up, b""), CloseConnection(talk().up.conversation, CloseMode.RESET)),
        (SendAction(1, Direction.REQUEST, b""), CloseAction(1, False, Message("client.ended"))),
    ],
)
def test_two_kinds_of_news_are_never_equal(one: object, other: object) -> None:
    fields = [getattr(one, name) for name in type(one).__match_args__]  # type: ignore[attr-defined]
    assert one == type(one)(*fields)
    assert one != other
    assert one != tuple(fields)
    with pytest.raises(AttributeError):
        setattr(one, type(one).__match_args__[0], None)  # type: ignore[attr-defined]
