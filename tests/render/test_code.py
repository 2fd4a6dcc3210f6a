"""Calls as something to paste elsewhere: each is tried on the peer it is for."""

from __future__ import annotations

import shlex
import subprocess
import sys

import pytest

from bcapscope.client import objects
from bcapscope.client.target import Target
from bcapscope.protocol.functions import FUNCTIONS, ObjectClass
from bcapscope.protocol.variant import EMPTY, VT, Variant
from bcapscope.render.code import call_line, hex_text, method_name, python_text
from bcapscope.traffic.opened import Opened
from tests.cli.run import run_here
from tests.client.server import UdpServer, udp_server

CONTROLLER = Opened(ObjectClass.CONTROLLER, 1, ("", "CaoProv.DENSO.VRC", "localhost", ""), None)
ROBOT = Opened(ObjectClass.ROBOT, 5, ("Gun dam", ""), CONTROLLER)
ANGLE = Opened(ObjectClass.VARIABLE, 7, ("@CURRENT_ANGLE", ""), ROBOT)
MODE = (Variant(VT.I4, 5), Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I4, 2))
POSE = Variant.array(VT.VARIANT, (Variant.array(VT.R8, (1.0, 2.5)), Variant(VT.BSTR, "J"), EMPTY))
MOVE = (Variant(VT.I4, 5), Variant(VT.I4, 1), POSE, Variant(VT.BSTR, "SPEED=10"))


def test_hex_is_pairs_of_digits() -> None:
    assert hex_text(b"\x01\xab") == "01 AB"


def test_call_line() -> None:
    assert call_line(Target("10.0.0.1"), 64, MODE, ROBOT) == (
        "bcapscope call 10.0.0.1 --robot 'Gun dam' Robot_Execute slvChangeMode i4:2"
    )
    assert call_line(Target("10.0.0.1", 5008, True), 64, MODE, None) == (
        "bcapscope call 10.0.0.1 --port 5008 --tcp Robot_Execute i4:5 slvChangeMode i4:2"
    )
    assert call_line(Target("h"), 101, (Variant(VT.I4, 7),), ANGLE) == (
        "bcapscope call h --variable @CURRENT_ANGLE --robot 'Gun dam' Variable_GetValue"
    )


def test_what_has_no_notation_has_no_line() -> None:
    nested = Variant.array(VT.VARIANT, (Variant.array(VT.VARIANT, (EMPTY, EMPTY)),))
    assert call_line(Target("h"), 64, (*MODE[:2], nested), ROBOT) is None
    assert call_line(Target("h"), 200, (), None) is None
    assert call_line(Target("h"), 64, MODE[:2], ROBOT) is None


@pytest.mark.parametrize("arguments", [MODE, MOVE], ids=["mode", "move"])
def test_the_line_makes_that_call(arguments: tuple[Variant, ...]) -> None:
    function_id = 64 if arguments is MODE else 72
    with udp_server() as server:
        line = call_line(Target("127.0.0.1", server.port), function_id, arguments, ROBOT)
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
        program = python_text(Target("127.0.0.1", server.port), function_id, arguments, ROBOT)
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=False, timeout=30)
        assert done.returncode == 0, done.stderr.decode()
        assert _made(server) == tuple(argument.value for argument in arguments[1:])


def test_the_program_for_what_has_no_handle_gives_numbers() -> None:
    program = python_text(Target("h", tcp=True), 64, MODE, None)
    assert "wait(service.session.call(64, [Variant(VT.I4, 5), " in program
    assert "over_tcp" in program


def test_hostile_strings_stay_strings() -> None:
    command = Variant(VT.BSTR, "a\"'); import os #\x1b[31m\u202e\ud800")
    program = python_text(Target("h"), 64, (MODE[0], command, EMPTY), ROBOT)
    assert program.isascii()
    compile(program, "program", "exec")
    assert "\x1b" not in program


@pytest.mark.parametrize("text", ["\x15rm -rf ~\r", "\n", "\x1b[A", "\x00", "\u202e", "\ud800"])
def test_no_line_holds_what_a_terminal_obeys_when_it_is_pasted(text: str) -> None:
    assert call_line(Target("h"), 64, (MODE[0], Variant(VT.BSTR, text), EMPTY), ROBOT) is None
    named = Opened(ObjectClass.ROBOT, 5, (text, ""), CONTROLLER)
    assert call_line(Target("h"), 64, MODE, named) is None


@pytest.mark.parametrize(
    "text", ["'; rm -rf ~ #", "$(reboot)", "`reboot`", "%s", "!!", "-x", "ロボット\u3000"]
)
def test_what_only_a_shell_would_obey_is_quoted(text: str) -> None:
    line = call_line(Target("h"), 64, (MODE[0], Variant(VT.BSTR, text), EMPTY), ROBOT)
    assert line is not None
    assert shlex.split(line)[-2] == text


def test_an_object_without_a_name_is_opened_without_a_name() -> None:
    with udp_server() as server:
        unnamed = Opened(ObjectClass.ROBOT, 5, ("", ""), CONTROLLER)
        line = call_line(Target("127.0.0.1", server.port), 64, MODE, unnamed)
        assert line is not None
        assert run_here("call", "--arm", *shlex.split(line)[2:]).code == 0
        calls = [call for peer in server.peers.values() for call in peer.executed]
        assert [call[2] for call in calls if call[0] == "Controller_GetRobot"] == [""]


def test_every_function_has_a_method_of_that_name() -> None:
    for function in FUNCTIONS.values():
        if function.owner is not ObjectClass.SERVICE and function.name != "Controller_Connect":
            assert hasattr(getattr(objects, function.owner), method_name(function)), function.name


def _made(server: UdpServer) -> tuple[object, ...]:
    calls = [call for peer in server.peers.values() for call in peer.executed]
    found = next(call for call in calls if call[0] in ("Robot_Execute", "Robot_Move"))
    return found[2:]
