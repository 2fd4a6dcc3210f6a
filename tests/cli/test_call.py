"""``bcapscope call`` against a server on loopback, as a user runs it."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.hresult import E_HANDLE, S_OK
from bcapscope.protocol.tables.simulator_marker import SIMULATOR_TEXT
from tests.cli.run import Ran, run_here
from tests.client.peer import Peer
from tests.client.server import udp_server

_CONNECT = ("Controller_Connect", "", "CaoProv.DENSO.VRC", "localhost", "")


def _as_simulator(peer: Peer) -> None:
    peer.answers["Variable_GetValue"] = S_OK, (Variant(VT.BSTR, SIMULATOR_TEXT),)


def _call(*words: str, simulator: bool = False) -> tuple[Ran, list[tuple[object, ...]]]:
    """Run ``bcapscope call``; return what it wrote and what the server executed."""

    def prepare(peer: Peer) -> None:
        peer.answers["Robot_GetHelp"] = E_HANDLE, ()
        peer.answers["Robot_GetName"] = None
        if simulator:
            _as_simulator(peer)

    with udp_server(prepare) as server:
        ran = run_here("call", "127.0.0.1", "--port", str(server.port), *words)
    executed = [call for peer in server.peers.values() for call in peer.executed]
    return ran, executed


def test_what_a_function_needs_is_opened_and_released() -> None:
    ran, executed = _call("Robot_Execute", "slvGetMode")
    assert ran.code == ExitCode.OK
    assert ran.out.startswith("Robot_Execute slvGetMode S_OK pVal=R8[1.0,2.0]  ")
    assert ran.out.endswith(" ms\n")
    assert executed == [
        ("Service_Start", ""),
        _CONNECT,
        ("Controller_GetRobot", 101, "Arm", ""),
        ("Robot_Execute", 102, "slvGetMode", None),
        ("Robot_Release", 102),
        ("Controller_Disconnect", 101),
        ("Service_Stop",),
    ]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_releases_everything(number: signal.Signals) -> None:
    def prepare(peer: Peer) -> None:
        peer.answers["Robot_GetName"] = None

    with udp_server(prepare) as server:
        words = ["call", "127.0.0.1", "--port", str(server.port), "Robot_GetName"]
        with subprocess.Popen([sys.executable, "-m", "bcapscope", *words]) as program:
            while not any("Robot_GetName" in peer.functions for peer in list(server.peers.values())):
                assert program.poll() is None
                threading.Event().wait(0.02)
            (peer,) = server.peers.values()
            peer.end()
            program.send_signal(number)
        assert program.returncode == ExitCode.INTERRUPTED
    assert peer.functions[-3:] == ["Robot_Release", "Controller_Disconnect", "Service_Stop"]


def test_names_and_strings_can_be_chosen() -> None:
    words = ("--service", ",WDT=400", "--provider", "P", "--robot", "Gundam", "--machine", "m")
    _, executed = _call(*words, "robot_getattribute")
    assert executed[:3] == [
        ("Service_Start", ",WDT=400"),
        ("Controller_Connect", "", "P", "m", ""),
        ("Controller_GetRobot", 101, "Gundam", ""),
    ]


def test_a_robot_s_variable_is_opened_on_the_robot() -> None:
    _, executed = _call("--variable", "@current_angle", "Variable_GetValue")
    assert executed[3] == ("Robot_GetVariable", 102, "@current_angle", "")
    _, executed = _call("--variable", "I7", "Variable_GetValue")
    assert executed[2] == ("Controller_GetVariable", 101, "I7", "")


def test_a_session_of_several_calls(tmp_path: Path) -> None:
    script = tmp_path / "calls.txt"
    script.write_bytes(b"\xef\xbb\xbf# look\nVariable_GetValue   # the second\n\nVariable_Release\n")
    words = (
        "Controller_GetVariable",
        "I1",
        "--exec",
        'Controller_GetVariable "I 2"',
        "--script",
        str(script),
    )
    ran, executed = _call(*words)
    assert [line.split()[0] for line in ran.lines] == [
        *["Controller_GetVariable"] * 2,
        *["Variable_GetValue", "Variable_Release"],
    ]
    assert executed[2:6] == [
        ("Controller_GetVariable", 101, "I1", ""),
        ("Controller_GetVariable", 101, "I 2", ""),
        ("Variable_GetValue", 103),
        ("Variable_Release", 103),
    ]
    assert ran.code == ExitCode.OK
    assert executed[6] == ("Variable_Release", 102)


@pytest.mark.parametrize(
    ("calls", "reason"),
    [
        (["Robot_Execute CurJnt", "Variable_GetValue"], "Variable_GetValue: no variable is open."),
        (
            ["Extension_GetName"],
            "Extension_GetName: no extension is open. Add --extension NAME, or open the extension",
        ),
        (
            ["Controller_GetVariable I1", "Variable_Release", "Variable_GetName"],
            "Variable_GetName: no variable is open. Add --variable NAME, or open the variable in an",
        ),
        (["Robot_Execute CurJnt", "Robot_Bogus"], "line 2: unknown function 'Robot_Bogus'"),
        (["Robot_Execute 'x"], "line 1: no closing quotation"),
        (["Robot_GetName", "\0" * 100_000], "line 2: longer than 65536 characters"),
        (
            ["Controller_GetVariable I1", "Variable_PutValue on"],
            "line 2: Variable_PutValue, newVal: 'on' is no",
        ),
        (["Robot_Execute CurJnt", "\udcff"], "not UTF-8"),
    ],
)
def test_calls_that_cannot_all_be_made_are_not_begun(calls: list[str], reason: str, tmp_path: Path) -> None:
    script = tmp_path / "calls.txt"
    script.write_bytes("\n".join(calls).encode(errors="surrogateescape"))
    ran, executed = _call("--script", str(script))
    assert (ran.code, executed) == (ExitCode.USAGE, [])
    assert reason in ran.err
    assert "Traceback" not in ran.err


def test_arguments_have_the_types_of_the_catalogue_or_their_own() -> None:
    _, executed = _call("--arm", "Robot_Execute", "slvChangeMode", "2")
    assert executed[3] == ("Robot_Execute", 102, "slvChangeMode", 2)
    assert executed[4] == ("Robot_Execute", 102, "slvChangeMode", 0)
    _, executed = _call("--arm", "Robot_Execute", "slvMove", "r4[]:10,20,-30")
    assert executed[3] == ("Robot_Execute", 102, "slvMove", (10.0, 20.0, -30.0))
    _, executed = _call("Robot_Speed", "-1", "50")
    assert executed[3] == ("Robot_Speed", 102, -1, 50.0)


@pytest.mark.parametrize(
    ("words", "value"),
    [
        (("--variable", "io128", "Variable_PutValue", "true"), True),
        (("--variable", "F1", "Variable_PutValue", "5"), 5.0),
        (("--variable", "P1", "Variable_PutValue", "1,2,3"), (1.0, 2.0, 3.0)),
        (("--variable", "S1", "Variable_PutValue", "12"), "12"),
        (("--variable", "I1", "Variable_PutValue", "i2:12"), 12),
        (("--variable", "own", "Variable_PutValue", "12"), 12),
        (("--variable", "S1", "Controller_GetVariable", "D3", "--exec", "Variable_PutValue 5"), 5.0),
        (("--exec", "Robot_GetVariable @speed", "--exec", "Variable_PutValue 50"), 50.0),
    ],
)
def test_a_variable_has_the_type_of_the_catalogue(words: tuple[str, ...], value: object) -> None:
    _, executed = _call(*words, "--arm")
    (written,) = (call[2] for call in executed if call[0] == "Variable_PutValue")
    assert (written, type(written)) == (value, type(value))


def test_an_explicit_handle() -> None:
    _, executed = _call("Robot_Execute", "55", "slvGetMode", "empty:")
    assert executed == [("Robot_Execute", 55, "slvGetMode", None)]


_SERVO_ON = ("--robot", "Arm", "Robot_GetVariable", "@Servo_On", "--exec")


@pytest.mark.parametrize(
    "words",
    [
        ("Robot_Move", "1", "@E J(1)"),
        ("Robot_Execute", "NoSuchCommand"),
        ("Robot_Execute", "Motor", "1"),
        ("Robot_Execute", "Motor", "i4[]:1,0"),
        ("Robot_Execute", "TakeArm"),
        ("Robot_Execute", "ExtSpeed", "50"),
        ("Robot_Execute", "slvChangeMode", "0x202"),
        ("Controller_Execute", "ManualReset"),
        ("Controller_Execute", "HandMoveA", "variant[]:i4:1;i4:1"),
        ("Task_Start", "1"),
        (*_SERVO_ON, "Variable_PutValue true"),
        ("--variable", "@SERVO_ON", "Variable_PutValue", "true"),
        ("--variable", "I1", "Variable_PutValue", "0"),
        ("Variable_PutValue", "77", "bool:false"),
    ],
)
def test_what_energises_or_moves_needs_arming_or_the_simulator(words: tuple[str, ...]) -> None:
    name = "Variable_PutValue" if "Variable_PutValue" in " ".join(words) else words[0]
    ran, executed = _call(*words)
    assert ran.code == ExitCode.UNARMED
    assert "may move or energise a robot" in ran.err
    assert "Add --arm" in ran.err
    assert name not in [call[0] for call in executed]
    assert executed[-1] == ("Service_Stop",)
    ran, executed = _call(*words, "--arm")
    assert ran.code == ExitCode.OK
    assert "Controller_GetVariable" not in [call[0] for call in executed if call[2:3] != ("I1",)]
    ran, executed = _call(*words, simulator=True)
    assert ran.code == ExitCode.OK
    assert name in [call[0] for call in executed]


@pytest.mark.parametrize(
    "words",
    [
        ("Robot_Halt",),
        ("Robot_Hold",),
        ("Task_Stop", "1"),
        ("--command", "C", "Command_Cancel"),
        ("Controller_Execute", "HandStop"),
        ("Robot_Execute", "slvChangeMode", "0"),
        ("Robot_Execute", "Motor", "0"),
        ("Robot_Execute", "Motor", "i4[]:0,0"),
        ("Robot_Execute", "GiveArm"),
        ("Robot_Execute", "CurJnt"),
        (*_SERVO_ON, "Variable_PutValue bool:false"),
        ("--variable", "@SERVO_ON", "Variable_PutValue", "false"),
    ],
)
def test_stopping_switching_off_and_reading_need_no_arming(words: tuple[str, ...]) -> None:
    ran, executed = _call(*words)
    assert ran.code == ExitCode.OK
    assert "Controller_GetVariable" not in [call[0] for call in executed]
    assert [call for call in executed if call[0] in (*words, "Variable_PutValue")]


def _logged(folder: Path) -> list[dict[str, object]]:
    paths = (folder / "bcapscope").rglob("actions-*.jsonl")
    return [json.loads(line) for path in paths for line in path.read_bytes().splitlines()]


def test_armed_calls_are_logged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    calls = ("--exec", "Robot_Execute CurJnt", "--exec", "Robot_Execute Motor 1", "--exec", "Robot_Halt")
    ran, _ = _call(*calls)
    assert (ran.code, _logged(tmp_path)) == (ExitCode.UNARMED, [])
    ran, _ = _call(*calls, simulator=True)
    assert (ran.code, _logged(tmp_path)) == (ExitCode.OK, [])
    ran, _ = _call(*calls, "--arm")
    assert ran.code == ExitCode.OK
    sent, received = _logged(tmp_path)
    assert (sent["program"], sent["host"], sent["sent"]) == ("call", "127.0.0.1", "Robot_Execute Motor")
    assert (received["call"], received["received"]) == ("Robot_Execute Motor", "S_OK")


def test_armed_calls_are_sent_though_the_log_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    ran, executed = _call("--arm", "Robot_Execute", "Motor", "1", "--exec", "Robot_Execute TakeArm")
    assert ran.code == ExitCode.OK
    assert len([call for call in executed if call[0] == "Robot_Execute"]) == 2
    assert ran.err.count("cannot write the action log") == 1
    assert "Calls are sent without a log entry." in ran.err


def test_a_refusal() -> None:
    ran, executed = _call("Robot_GetHelp", "--exec", "Robot_GetTag")
    assert ran.code == ExitCode.REFUSED
    assert ran.out.startswith("Robot_GetHelp E_HANDLE (")
    assert ("Robot_GetTag", 102) not in executed


def test_no_answer_lists_the_tries() -> None:
    ran, _ = _call("Robot_GetName", "--timeout", "400", "--retries", "1")
    assert ran.code == ExitCode.UNANSWERED
    assert "Robot_GetName got no reply in time, 2 attempts:" in ran.err
    first, second = map(int, re.findall(r"serial (\d+), reserved", ran.err))
    assert second == first + 1
    assert f"serial {second}, reserved {first}, sent at" in ran.err


def test_json() -> None:
    ran, _ = _call("Robot_Execute", "CurJnt", "--json")
    (record,) = map(json.loads, ran.lines)
    assert record["kind"] == "response"
    assert record["function"] == "Robot_Execute"
    assert record["command"] == "CurJnt"
    assert record["hresult"] == 0
    assert record["args"] == [{"name": "pVal", "type": "VT_R8|VT_ARRAY", "value": [1.0, 2.0]}]
    assert record["tries"] == 1
    assert 0 < record["took_ms"] < 60_000


def test_hex() -> None:
    ran, _ = _call("Robot_GetAttribute", "--hex")
    assert ran.lines[1].startswith("  sent to 127.0.0.1:")
    assert "01 1e 00 00 00 04 00 00" in ran.out.lower()
    assert sum("received from" in line for line in ran.lines) == 1


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ((), "no function given"),
        (("Robot_Mov",), "Robot_Move?"),
        (("Robot_Move",), "lComp is missing"),
        (("Robot_GoHome", "1", "2"), "Robot_GoHome takes hRobot"),
        (("Robot_Speed", "x", "1"), "Robot_Speed, lAxis: 'x' is not a VT_I4"),
        (("--exec", "Robot_Mov"), "line 1: unknown function"),
        (("--tcp", "--convention", "seed", "Service_Start"), "seed does not exist on TCP"),
        (("--hex", "--json", "Service_Start"), "exclude each other"),
    ],
)
def test_what_makes_no_sense(words: tuple[str, ...], reason: str) -> None:
    ran = run_here("call", "127.0.0.1", *words)
    assert ran.code == ExitCode.USAGE
    assert reason in ran.err


def test_nobody_listens() -> None:
    ran = run_here("call", "127.0.0.1", "--tcp", "--port", "1", "Service_Start")
    assert ran.code == ExitCode.UNANSWERED
    assert ran.err == "bcapscope: 127.0.0.1:1 over TCP: connection refused\n"
    ran = run_here("call", "127.0.0.1", "--port", "1", "--timeout", "5", "--retries", "0", "Service_Start")
    assert ran.code == ExitCode.UNANSWERED
    assert ran.err.startswith("bcapscope: 127.0.0.1:1 over UDP: Service_Start got no reply")
    assert "connection refused at" in ran.err


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (
            ("Robot_Execute", "Motor", "1", "0"),
            "Robot_Execute takes bstrCommand vntParam. Remove '0'. If vntParam has several values, "
            "separate them with commas: 1,0",
        ),
        (("Robot_Execute", "2", "Motor", "1", "0"), "takes hRobot bstrCommand vntParam. Remove '0'"),
        (("Controller_GetTag", "1", "2", "3"), "Controller_GetTag takes hController. Remove '2', '3'"),
        (("Service_Stop", "now"), "Service_Stop takes no arguments. Remove 'now'"),
    ],
)
def test_arguments_that_are_too_many_are_named(words: tuple[str, ...], reason: str) -> None:
    done = run_here("call", "127.0.0.1", *words)
    assert done.code == ExitCode.USAGE
    assert reason in done.err


def test_several_values_of_one_argument() -> None:
    ran, executed = _call("Robot_Execute", "Motor", "1,0", simulator=True)
    assert ran.code == ExitCode.OK
    assert ("Robot_Execute", 102, "Motor", (1, 0)) in executed
