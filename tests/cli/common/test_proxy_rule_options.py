"""The proxy's rules through real sockets: faults, guard, intercept, scripts, and `proxy ctl`."""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from bcapscope.cli.common.proxy_rule_options import RuleOptions
from bcapscope.client import RetryPolicies, open_session, over_tcp, over_udp
from bcapscope.faults.fault_injector import FaultInjector
from bcapscope.faults.fault_notation import read_fault
from bcapscope.faults.quantities import FrameCondition
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.requester import (
    CallAnswered,
    CallRefused,
    CallTimedOut,
    LateReply,
    RequesterEvent,
    RequesterOutcome,
    RetryPolicy,
)
from bcapscope.protocol.tables.hresult import E_ACCESSDENIED
from bcapscope.proxy.intercept import HOLD_TIME_NS as PATIENCE_OF_HELD
from tests.cli.proxied import PATIENCE, proxied
from tests.cli.run import run, run_here
from tests.faults.traffic import passes
from tests.faults.traffic import talk as conversation

MS = 1_000_000
TRIES = RetryPolicy(300 * MS, 6)
CALLS = 20
SEED = 9
"""With it three messages are lost on each way."""
GET_TAG, PUT_TAG, EXECUTE, HALT = 22, 23, 64, 70


class Tally:
    """What one client has counted by itself.

    Attributes:
        settled: how its calls ended.
        late: replies that came when nobody waited for them any more.
    """

    def __init__(self) -> None:
        self.settled: list[RequesterOutcome] = []
        self.late = 0

    def hear(self, event: RequesterEvent) -> None:
        """Count what comes late."""
        self.late += isinstance(event, LateReply)

    @property
    def retries(self) -> int:
        """How often it has asked again."""
        return sum(len(each.attempts) - 1 for each in self.settled)

    @property
    def given_up(self) -> int:
        """How many of its calls had no answer."""
        return sum(isinstance(each, CallTimedOut) for each in self.settled)


async def talk(port: int) -> Tally:
    """Make calls over UDP, one after the other, all in plain sight."""
    tally = Tally()
    caller_sees = tally.hear
    async with open_session(
        over_udp("127.0.0.1", port), retry_policies=RetryPolicies(TRIES), listener=caller_sees
    ) as session:
        for number in range(CALLS):
            arguments = (Variant(VT.I4, 99), Variant(VT.I4, number))
            tally.settled.append(await session.perform_call(PUT_TAG, arguments))
    return tally


def recorded(path: Path, kind: str) -> list[dict[str, Any]]:
    """Read a recording: its frames or its calls."""
    return [json.loads(line) for line in run_here(kind, path, "--json").lines]


def fates(frames: list[dict[str, Any]], faults: tuple[str, ...], seed: int) -> list[bool]:
    """Decide again which of the frames that came are lost."""
    machine = FaultInjector(map(read_fault, faults), seed=seed, now=0)
    flows = conversation()
    return [
        not passes(machine, flows.up if frame["kind"] == "request" else flows.down, b"") for frame in frames
    ]


def test_drops_retries_and_the_clients_own_count_agree(tmp_path: Path) -> None:
    path = tmp_path / "passed.pcapng"
    faults = "loss=15% request name up", "loss=15% reply name down"
    words = "--fault", faults[0], "--fault", faults[1], "--seed", str(SEED)
    with proxied(*words, "--record", path, "-q") as proxy:
        tally = asyncio.run(talk(proxy.port))
        said = proxy.end()
    clients_side = f"127.0.0.1:{proxy.port}"
    frames = recorded(path, "decode")
    notes = Counter(note for frame in frames for note in frame.get("comments", ()))
    assert notes["up: dropped"] >= 3
    assert notes["down: dropped"] >= 3
    assert f"fault up: injected {notes['up: dropped']} times" in said
    assert f"fault down: injected {notes['down: dropped']} times" in said
    calls = recorded(path, "calls")
    assert sum(call["retries"] for call in calls if call["server"] == clients_side) == tally.retries
    # Each try was answered in time, answered late, or lost on one of the two ways.
    assert notes.total() + tally.late == tally.retries + tally.given_up
    # The seed alone has decided which, of what came on either side.
    came = [frame for frame in frames if (frame["kind"] == "request") == (frame["dst"] == clients_side)]
    came = [frame for frame in came if clients_side != frame["src"]]
    assert [bool(frame.get("comments")) for frame in came] == fates(came, faults, SEED)


@pytest.mark.parametrize("transport", ["udp", "tcp"])
def test_a_guard_answers_in_the_controllers_place(transport: str) -> None:
    async def ask(port: int) -> list[RequesterOutcome]:
        reach = over_udp if transport == "udp" else over_tcp
        async with open_session(reach("127.0.0.1", port)) as session:
            await session.invoke("Service_Start", "")
            found = await session.invoke("Controller_Connect", "", "CaoProv.DENSO.VRC", "localhost", "")
            robot = await session.invoke("Controller_GetRobot", found.arguments[0].variant.value, "Arm", "")
            handle = Variant(VT.I4, robot.arguments[0].variant.value)
            take_arm = (handle, Variant(VT.BSTR, "TakeArm"), Variant.array(VT.I4, (0, 0)))
            where = (handle, Variant(VT.BSTR, "CurJnt"), Variant(VT.EMPTY, None))
            return [
                await session.perform_call(EXECUTE, take_arm),
                await session.perform_call(EXECUTE, where),
                await session.perform_call(HALT, (handle, Variant(VT.BSTR, ""))),
                await session.perform_call(200, ()),
            ]

    with proxied("--read-only", "-q") as proxy:
        moved, read, halted, unknown = asyncio.run(ask(proxy.port))
        said = proxy.end()
    for refused in (moved, unknown):
        assert isinstance(refused, CallRefused)
        assert refused.reply.code == E_ACCESSDENIED
    assert isinstance(read, CallAnswered)
    assert isinstance(halted, CallAnswered)
    assert "guard: refused 2 times" in said


def test_a_stream_is_delayed_and_then_reset() -> None:
    async def ask(port: int) -> tuple[int, str]:
        async with open_session(over_tcp("127.0.0.1", port)) as session:
            started = await session.perform_call(GET_TAG, (Variant(VT.I4, 1),))
            assert isinstance(started, CallAnswered | CallRefused)
            try:
                await session.perform_call(PUT_TAG, (Variant(VT.I4, 1), Variant(VT.I4, 1)))
            except ConnectionError as error:
                return started.elapsed, str(error)
            return started.elapsed, ""

    words = "--fault", "delay=120ms request", "--fault", "close if function == Controller_PutTag"
    with proxied(*words, "-q") as proxy:
        took, problem = asyncio.run(ask(proxy.port))
        said = proxy.end()
    assert took >= 120 * MS
    assert "reset" in problem
    assert "close: connection reset" in said


def ctl(address: str, *words: str) -> list[str]:
    """Ask the proxy; it must not refuse."""
    ran = run_here("proxy", "ctl", address, *words)
    assert ran.code == 0, ran.err
    return ran.lines


def test_a_message_is_held_edited_and_sent_on(tmp_path: Path) -> None:
    words = "--intercept", "kind == response and function == Variable_GetValue", "-q"
    with proxied(*words, "--control", tmp_path / "ctl.sock") as proxy:
        call = [sys.executable, "-m", "bcapscope", "call", "127.0.0.1", "-p", str(proxy.port)]
        more = ["--tcp", "--timeout", str(PATIENCE * 1000), "--json", "Variable_GetValue", "--variable", "I1"]
        with subprocess.Popen([*call, *more], stdout=subprocess.PIPE, text=True) as client:
            while not (held := ctl(proxy.control, "held")):
                assert client.poll() is None
            assert "S_OK Variable_GetValue pVal=I4(0)  # sent unchanged in " in held[0]
            assert (
                run_here("proxy", "ctl", proxy.control, "edit", "7", "set arg[0]=1").err
                == "no message 7 is held\n"
            )
            ctl(proxy.control, "edit", "1", "set arg[0]=77")
            out, _ = client.communicate(timeout=PATIENCE)
        assert json.loads(out.splitlines()[-1])["args"][0]["value"] == 77
        assert ctl(proxy.control, "held") == []
        proxy.end()
    assert not (tmp_path / "ctl.sock").exists()


def test_faults_come_and_go_while_it_runs() -> None:
    with proxied("-q", "--control", "127.0.0.1:0") as proxy:
        assert ctl(proxy.control, "add", "answer=E_FAIL if function == Controller_Connect") == ["answer"]
        refused = run("call", "127.0.0.1", "-p", str(proxy.port), "Controller_GetTag")
        assert "E_FAIL" in refused.err + refused.out
        (line,) = ctl(proxy.control, "rules")
        assert line.split() == [
            "on",
            "answer",
            "injected",
            "1",
            *["answer=E_FAIL", "if", "function", "==", "Controller_Connect"],
        ]
        ctl(proxy.control, "off", "answer")
        answered = run("call", "127.0.0.1", "-p", str(proxy.port), "--variable", "I1", "Variable_GetValue")
        assert "S_OK" in answered.out
        ctl(proxy.control, "remove", "answer")
        assert ctl(proxy.control, "rules") == []
        figures = dict(line.split(": ", 1) for line in ctl(proxy.control, "stats"))
        assert int(figures["came up"]) > 0
        assert (figures["guard"], figures["injected"], figures["intercept"]) == ("no", "none", "none")
        assert re.fullmatch(r"127.0.0.1:\d+ > 127.0.0.1:\d+", figures["listening"])
        first, _second = ctl(proxy.control, "clients")
        assert re.fullmatch(r"127.0.0.1:\d+ > 127.0.0.1:\d+ udp open  for .* s, \d+ up, \d+ down", first)
        wrong = run_here("proxy", "ctl", proxy.control, "add", "dely=3ms")
        assert (wrong.code, wrong.err.splitlines()[-1]) == (8, "  ^")
        proxy.end()
    gone = run_here("proxy", "ctl", proxy.control, "rules")
    assert (gone.code, gone.err) == (
        4,
        f"no proxy listens for control on {proxy.control}: connection refused\n",
    )


def test_a_script_that_goes_wrong_is_told_once_and_all_passes(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(
        "class Mine:\n"
        "    def request(self, message):\n        1 / 0\n"
        "    def settled(self, call):\n        self.last = call\n"
        "    def done(self):\n        print('done after', self.last.kind.command)\n"
    )
    with proxied("--script", path, "-q") as proxy:
        words = "-e", "Robot_Execute CurJnt", "-e", "Robot_Execute CurPos"
        assert run("call", "127.0.0.1", "-p", str(proxy.port), *words).code == 0
        said = proxy.end()
    assert (
        said.count("Mine.request: ZeroDivisionError: division by zero (mine.py line 3) (reported once)") == 1
    )
    assert "done after None" in said


@pytest.mark.parametrize(
    ("words", "code", "reason"),
    [
        (("--fault", "dely=3ms"), 2, "there is no action 'dely', did you mean 'delay'?\n  dely=3ms\n  ^"),
        (("--fault", "drop if comand == 1"), 2, "did you mean 'command'?"),
        (("--fault", "drop name x", "--fault", "drop name x"), 2, "two faults have the name x"),
        (("--block", "slvMve"), 2, "did you mean 'slvMove'?"),
        (("--intercept", "serial >"), 2, "the value to compare serial with is missing"),
        (("--hold", "5"), 2, "'5' is not a duration"),
        (("--script", "none.py"), 2, "does not exist"),
        (("--rules", "none.yaml"), 2, "cannot read none.yaml: No such file or directory"),
        pytest.param(
            ("--rules", "/dev/zero"),
            2,
            "/dev/zero: longer than",
            marks=pytest.mark.skipif(sys.platform == "win32", reason="no file there that never ends"),
        ),
        (("--control", "0.0.0.0:5"), 4, "0.0.0.0 is not on loopback"),
    ],
)
def test_options_that_make_no_sense_are_told(words: tuple[str, ...], code: int, reason: str) -> None:
    ran = run_here("proxy", "--listen", "127.0.0.1:0", "--to", "127.0.0.1:9", *words)
    assert ran.code == code, ran.err
    assert reason in ran.err


def test_a_rule_file_is_read_and_its_error_has_a_line(tmp_path: Path) -> None:
    path = tmp_path / "rules.yaml"
    path.write_text("faults:\n  - action: delay\n    time: 3\n")
    ran = run_here("proxy", "--listen", "127.0.0.1:0", "--to", "127.0.0.1:9", "--rules", path)
    assert ran.code == 2
    assert "rules.yaml: line 3: faults[0].time: 3 is not a duration" in ran.err


def test_a_script_that_cannot_be_used_ends_it(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text("x = 1\n")
    ran = run_here("proxy", "--listen", "127.0.0.1:0", "--to", "127.0.0.1:9", "--script", path)
    assert (ran.code, "has no class with a method" in ran.err) == (4, True)


@pytest.mark.parametrize(("hold", "patience"), [(None, PATIENCE_OF_HELD), (0, 0)])
def test_messages_are_held_for_as_long_as_is_wished(hold: int | None, patience: int) -> None:
    condition = FrameCondition.read("true")
    made = RuleOptions(1, intercept=condition, hold_ns=hold).build_rules()
    assert made is not None
    assert made.intercept.hold_time == patience


def test_the_notation_is_explained() -> None:
    ran = run_here("proxy", "--help-faults")
    assert ran.code == 0
    assert "delay=3ms±1ms" in ran.out
