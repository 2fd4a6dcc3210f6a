"""Calls as something to paste elsewhere: each is tried on the peer it is for."""

from __future__ import annotations

import ast
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.client import remote_objects
from bcapscope.client.controller_target import ControllerTarget
from bcapscope.client.handle_table import ObjectHandle
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.tables.function_table import FUNCTIONS, Function, ObjectClass, ResultKind
from bcapscope.render.call_code import hex_text, method_name, python_program, shell_command
from bcapscope.render.escape import printable
from tests.cli.run import run_here
from tests.client.server import UdpServer, udp_server

CONTROLLER = ObjectHandle(ObjectClass.CONTROLLER, 1, ("", "CaoProv.DENSO.VRC", "localhost", ""), None)
ROBOT = ObjectHandle(ObjectClass.ROBOT, 5, ("Gun dam", ""), CONTROLLER)
ANGLE = ObjectHandle(ObjectClass.VARIABLE, 7, ("@CURRENT_ANGLE", ""), ROBOT)
MODE = (Variant(VT.I4, 5), Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I4, 2))
POSE = Variant.array(VT.VARIANT, (Variant.array(VT.R8, (1.0, 2.5)), Variant(VT.BSTR, "J"), EMPTY))
MOVE = (Variant(VT.I4, 5), Variant(VT.I4, 1), POSE, Variant(VT.BSTR, "SPEED=10"))


def test_hex_is_pairs_of_digits() -> None:
    assert hex_text(b"\x01\xab") == "01 AB"


def test_call_line() -> None:
    assert shell_command(ControllerTarget("10.0.0.1"), 64, MODE, ROBOT) == (
        "bcapscope call 10.0.0.1 --robot 'Gun dam' Robot_Execute slvChangeMode i4:2"
    )
    assert shell_command(ControllerTarget("10.0.0.1", 5008, True), 64, MODE, None) == (
        "bcapscope call 10.0.0.1 --port 5008 --tcp Robot_Execute i4:5 slvChangeMode i4:2"
    )
    assert shell_command(ControllerTarget("h"), 101, (Variant(VT.I4, 7),), ANGLE) == (
        "bcapscope call h --variable @CURRENT_ANGLE --robot 'Gun dam' Variable_GetValue"
    )


def test_what_has_no_notation_has_no_line() -> None:
    nested = Variant.array(VT.VARIANT, (Variant.array(VT.VARIANT, (EMPTY, EMPTY)),))
    assert shell_command(ControllerTarget("h"), 64, (*MODE[:2], nested), ROBOT) is None
    assert shell_command(ControllerTarget("h"), 200, (), None) is None
    assert shell_command(ControllerTarget("h"), 64, MODE[:2], ROBOT) is None


@pytest.mark.parametrize("arguments", [MODE, MOVE], ids=["mode", "move"])
def test_the_line_makes_that_call(arguments: tuple[Variant, ...]) -> None:
    function_id = 64 if arguments is MODE else 72
    with udp_server() as server:
        line = shell_command(ControllerTarget("127.0.0.1", server.port), function_id, arguments, ROBOT)
        assert line is not None
        ran = run_here("call", "--arm", *shlex.split(line)[2:])
        assert ran.code == 0, ran.err
        assert _made(server) == tuple(argument.value for argument in arguments[1:])


@pytest.mark.parametrize(
    ("function_id", "arguments"),
    [(64, MODE), (72, MOVE), (64, (*MODE[:2], Variant.array(VT.R4, (float("inf"),))))],
    ids=["mode", "move", "infinite"],
)
def test_the_program_makes_that_call(function_id: int, arguments: tuple[Variant, ...]) -> None:
    with udp_server() as server:
        program = python_program(ControllerTarget("127.0.0.1", server.port), function_id, arguments, ROBOT)
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=False, timeout=30)
        assert done.returncode == 0, done.stderr.decode()
        assert _made(server) == tuple(argument.value for argument in arguments[1:])


def _arguments(function: Function) -> tuple[Variant, ...]:
    """Give one argument of each type that a function takes, the handle 5."""
    values = {"VT_I4": Variant(VT.I4, 5), "VT_R4": Variant(VT.R4, 2.5), "VT_BSTR": Variant(VT.BSTR, "x")}
    return tuple(values.get(param.type, POSE) for param in function.params)


def _subject(function: Function) -> ObjectHandle | None:
    """Open an object of the class that a function belongs to."""
    if not function.takes_handle:
        return None
    if function.owner is ObjectClass.CONTROLLER:
        return CONTROLLER._replace(handle=5)
    return ObjectHandle(
        function.owner, 5, () if function.owner is ObjectClass.MESSAGE else ("x", ""), CONTROLLER
    )


def _each() -> Iterator[tuple[Function, ObjectHandle | None]]:
    for function in FUNCTIONS.values():
        yield function, None
        if function.takes_handle:
            yield function, _subject(function)


def _name(value: object) -> str:
    return (
        value.name
        if isinstance(value, Function)
        else "known"
        if isinstance(value, ObjectHandle)
        else "unknown"
    )


@pytest.mark.parametrize(("function", "subject"), list(_each()), ids=_name)
def test_the_program_of_each_function_makes_that_call(
    function: Function, subject: ObjectHandle | None, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = _arguments(function)
    with udp_server() as server:
        target = ControllerTarget("127.0.0.1", server.port, service=",WDT=400")
        exec(compile(python_program(target, function.id, arguments, subject), "program", "exec"), {})
        calls = [call for peer in server.peers.values() for call in peer.executed]
    wanted = (function.name, *(argument.value for argument in arguments))
    if subject is None:
        assert wanted in calls
    else:
        assert (wanted[0], *wanted[2:]) in [(call[0], *call[2:]) for call in calls]
    assert bool(capsys.readouterr().out) is (subject is None or function.result is not ResultKind.NONE)


def test_the_programs_of_all_functions_pass_a_strict_type_check(tmp_path: Path) -> None:
    for function, subject in _each():
        for tcp in (False, True):
            program = python_program(
                ControllerTarget("h", tcp=tcp), function.id, _arguments(function), subject
            )
            (tmp_path / f"f{function.id}_{subject is None}_{tcp}.py").write_text(program)
    argv = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path / "cache"), str(tmp_path)]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("argument", "values"),
    [
        (Variant(VT.BSTR, "not a number"), ("not a number", 2.5, 2.5)),
        (Variant.array(VT.I4, (1, 2)), ((1, 2), 2.5, 2.5)),
        (EMPTY, (None, 2.5, 2.5)),
    ],
)
def test_an_argument_of_another_type_keeps_it(argument: Variant, values: tuple[object, ...]) -> None:
    speed = Variant(VT.R4, 2.5)
    with udp_server() as server:
        target = ControllerTarget("127.0.0.1", server.port)
        program = python_program(target, 65, (Variant(VT.I4, 5), argument, speed, speed), ROBOT)
        assert "robot.handle" in program
        exec(compile(program, "program", "exec"), {})
        calls = [call for peer in server.peers.values() for call in peer.executed]
    assert next(call for call in calls if call[0] == "Robot_Accelerate")[2:] == values


@pytest.mark.parametrize("asked", [(), ("a", "b", "c"), ("a", "b", "c", "d", "e")])
@pytest.mark.parametrize("kind", [ObjectClass.CONTROLLER, ObjectClass.FILE, ObjectClass.MESSAGE])
def test_an_object_is_opened_whatever_strings_its_request_had(
    kind: ObjectClass, asked: tuple[str, ...]
) -> None:
    opened = ObjectHandle(kind, 5, asked, None if kind is ObjectClass.CONTROLLER else CONTROLLER)
    with udp_server() as server:
        program = python_program(
            ControllerTarget("127.0.0.1", server.port), 200, (Variant(VT.I4, 5),), opened
        )
        exec(compile(program.replace("(200,", "(19,"), "program", "exec"), {})
        assert any(peer.executed for peer in server.peers.values())


nested = st.recursive(
    st.one_of(
        st.none().map(lambda _: EMPTY),
        st.integers(-(2**31), 2**31 - 1).map(lambda value: Variant(VT.I4, value)),
        st.floats(width=32).map(lambda value: Variant(VT.R4, value)),
        st.floats().map(lambda value: Variant(VT.R8, value)),
        st.booleans().map(lambda value: Variant(VT.BOOL, value)),
        st.text(st.characters()).map(lambda value: Variant(VT.BSTR, value)),
        st.binary().map(lambda value: Variant.array(VT.UI1, value)),
        st.lists(st.text(), max_size=3).map(lambda value: Variant.array(VT.BSTR, tuple(value))),
        st.binary().map(lambda value: Variant(0x4D, value)),
        st.integers(0, 0xFFFF).map(lambda vt: Variant(vt, None)),
    ),
    lambda inner: st.lists(inner, max_size=3).map(lambda value: Variant.array(VT.VARIANT, tuple(value))),
)


@given(nested)
def test_any_argument_is_written_as_the_same_value(argument: Variant) -> None:
    program = python_program(ControllerTarget("h"), 200, (argument,), None)
    assert all(line == printable(line) for line in program.split("\n"))
    (call,) = [
        node
        for node in ast.walk(ast.parse(program))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "call"
    ]
    value = eval(compile(ast.Expression(call.args[1]), "argument", "eval"), {"VT": VT, "Variant": Variant})
    assert repr(list(map(_plain, value))) == repr(
        [_plain(argument)]
    )  # as text, since NaN differs from itself


def _plain(variant: Variant) -> tuple[object, ...]:
    value = variant.value
    items = (
        tuple(_plain(each) if isinstance(each, Variant) else each for each in value)
        if isinstance(value, tuple)
        else value
    )
    return int(variant.vt), items, variant.elements


def test_hostile_strings_stay_strings() -> None:
    command = Variant(VT.BSTR, "a\"'); import os #\x1b[31m\u202e\ud800")
    program = python_program(ControllerTarget("h"), 64, (MODE[0], command, EMPTY), ROBOT)
    assert program.isascii()
    compile(program, "program", "exec")
    assert "\x1b" not in program


@pytest.mark.parametrize("text", ["\x15rm -rf ~\r", "\n", "\x1b[A", "\x00", "\u202e", "\ud800"])
def test_no_line_holds_what_a_terminal_obeys_when_it_is_pasted(text: str) -> None:
    assert shell_command(ControllerTarget("h"), 64, (MODE[0], Variant(VT.BSTR, text), EMPTY), ROBOT) is None
    named = ObjectHandle(ObjectClass.ROBOT, 5, (text, ""), CONTROLLER)
    assert shell_command(ControllerTarget("h"), 64, MODE, named) is None


@pytest.mark.parametrize(
    "text", ["'; rm -rf ~ #", "$(reboot)", "`reboot`", "%s", "!!", "-x", "ロボット\u3000"]
)
def test_what_only_a_shell_would_obey_is_quoted(text: str) -> None:
    line = shell_command(ControllerTarget("h"), 64, (MODE[0], Variant(VT.BSTR, text), EMPTY), ROBOT)
    assert line is not None
    assert shlex.split(line)[-2] == text


def test_an_object_without_a_name_is_opened_without_a_name() -> None:
    with udp_server() as server:
        unnamed = ObjectHandle(ObjectClass.ROBOT, 5, ("", ""), CONTROLLER)
        line = shell_command(ControllerTarget("127.0.0.1", server.port), 64, MODE, unnamed)
        assert line is not None
        assert run_here("call", "--arm", *shlex.split(line)[2:]).code == 0
        calls = [call for peer in server.peers.values() for call in peer.executed]
        assert [call[2] for call in calls if call[0] == "Controller_GetRobot"] == [""]


def test_every_function_has_a_method_of_that_name() -> None:
    for function in FUNCTIONS.values():
        if function.owner is not ObjectClass.SERVICE and function.name != "Controller_Connect":
            assert hasattr(getattr(remote_objects, function.owner), method_name(function)), function.name


def _made(server: UdpServer) -> tuple[object, ...]:
    calls = [call for peer in server.peers.values() for call in peer.executed]
    found = next(call for call in calls if call[0] in ("Robot_Execute", "Robot_Move"))
    return found[2:]
