"""Scripts of `proxy` in their own process: what they can do, and that nothing in them stops the relay."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cli.proxied import PATIENCE, Proxied, proxied
from tests.cli.run import run, run_here
from tests.proxy.relaying import eventually

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals, and sockets that are inherited")

PID = "import os\nopen({pid!r}, 'w').write(str(os.getpid()))\n"
CALL = "call", "127.0.0.1", "--tcp", "-p"


class Script:
    """A script and the process in which it runs.

    Attributes:
        path: of the script.
    """

    def __init__(self, folder: Path, text: str) -> None:
        self.path = folder / "mine.py"
        self._pid = folder / "pid"
        self.path.write_text(PID.format(pid=str(self._pid)) + text, "utf-8")

    @property
    def pid(self) -> int:
        """Number of the process, once it has begun."""
        eventually(lambda: self._pid.exists() and self._pid.read_text(), "the script")
        return int(self._pid.read_text())

    @property
    def runs(self) -> bool:
        """Whether the process is there."""
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        return "Z" not in Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()[0]


def halted(proxy: Proxied) -> float:
    """Halt the robot through a proxy; give the milliseconds that took."""
    ran = run(*CALL, str(proxy.port), "--json", "Robot_Halt")
    assert ran.code == 0, ran.err
    return float(json.loads(ran.lines[-1])["took_ms"])


def test_scripts_see_change_answer_and_remember(tmp_path: Path) -> None:
    script = Script(
        tmp_path,
        "class Mine:\n"
        "    def __init__(self):\n        self.seen = []\n"
        "    def request(self, message):\n"
        "        self.seen.append(message.command)\n"
        "        if message.command == 'CurPos':\n            message.answer('E_FAIL')\n"
        "        if message.command == 'CurJnx':\n"
        "            message.data = message.data.replace('CurJnx'.encode('utf-16-le'), "
        "'CurJnt'.encode('utf-16-le'))\n"
        "    def settled(self, call):\n        self.last = call\n"
        "    def connected(self, client):\n        print('came', client.number, client.transport)\n"
        "    def gone(self, client):\n        print('went', client.number)\n"
        "    def done(self):\n"
        "        print('saw', self.seen.count('CurJnt'), 'last', self.last.request.item.code)\n",
    )
    path = tmp_path / "passed.pcapng"
    with proxied("--script", script.path, "-q", "--record", path) as proxy:
        for command, code in (("CurJnt", 0), ("CurJnt", 0), ("CurPos", 1), ("CurJnx", 0)):
            ran = run(*CALL, str(proxy.port), "-e", f"Robot_Execute {command}")
            assert bool(ran.code) is bool(code), ran.out + ran.err
        said = proxy.end()
    assert "came 1 tcp" in said
    assert "went 4" in said
    assert "saw 2 last 2" in said
    frames = [json.loads(line) for line in run_here("decode", path, "--json").lines]
    notes = [note for frame in frames for note in frame.get("comments", ())]
    assert notes.count("addon: changed") == 1
    assert notes.count("addon: answered") == 2  # on the request, and on the answer
    assert not script.runs


LOOP = "                while True:\n                    pass\n"
STUBBORN = (
    "import signal, time\n"
    "for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):\n"
    "    signal.signal(number, signal.SIG_IGN)\n"
    "class Mine:\n"
    "    def request(self, message):\n"
    "        if message.command != 'CurJnt':\n            return\n"
    "        while True:\n"
    "            try:\n{body}"
    "            except BaseException:\n                pass\n"
)


@pytest.mark.parametrize("body", [LOOP, "                time.sleep(60)\n"], ids=["loops", "sleeps"])
def test_a_script_that_takes_for_ever_is_switched_off_and_all_but_motion_passes(
    tmp_path: Path, body: str
) -> None:
    script = Script(tmp_path, STUBBORN.format(body=body))
    words = "--script", script.path, "-q", "--control", tmp_path / "ctl.sock"
    with proxied(*words) as proxy:
        assert script.runs
        ran = run(*CALL, str(proxy.port), "-e", "Robot_Execute CurJnt")
        assert ran.code == 0, ran.err
        assert halted(proxy) < 1000
        moved = run(*CALL, str(proxy.port), "Robot_Move", "1", "J(1,2,3,4,5,6)", "")
        assert "E_ACCESSDENIED" in moved.out + moved.err
        eventually(lambda: not script.runs)
        stats = dict(line.split(": ", 1) for line in run_here("proxy", "ctl", proxy.control, "stats").lines)
        why = "it took longer than 100 ms for request (Robot_Execute CurJnt); mine.py line "
        assert stats["scripts"].startswith(f"off: {why}")
        said = proxy.end()
    assert f"script mine.py is switched off: {why}" in said
    assert ". Stops pass, motion is refused, everything else passes unchanged. " in said
    assert "guard" not in said


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("os._exit(3)", "its process ended during request (Robot_Execute CurJnt); exit code 3"),
        (
            "import ctypes; ctypes.string_at(0)",
            "its process ended during request (Robot_Execute CurJnt); SIGSEGV; mine.py line 6 in request",
        ),
        ("os.closerange(3, 60)", "its process ended during request (Robot_Execute CurJnt); exit code 1"),
        (
            "[os.write(each, b'x' * 99) for each in range(3, 20) if is_socket(each)]",
            "its process sent the proxy an invalid message",
        ),
    ],
    ids=["exit", "crash", "close", "write"],
)
def test_a_script_that_breaks_its_process_is_switched_off(tmp_path: Path, text: str, why: str) -> None:
    script = Script(
        tmp_path,
        "class Mine:\n"
        "    def request(self, message):\n"
        "        if message.command == 'CurJnt':\n"
        f"            {text}\n"
        "def is_socket(number):\n"
        "    try:\n        return os.readlink(f'/proc/self/fd/{number}').startswith('socket')\n"
        "    except OSError:\n        return False\n",
    )
    with proxied("--script", script.path, "-q") as proxy:
        assert run(*CALL, str(proxy.port), "-e", "Robot_Execute CurJnt").code == 0
        assert halted(proxy) < 1000
        eventually(lambda: any("is switched off" in line for line in proxy.said))
        said = proxy.end()
    assert f"script mine.py is switched off: {why}" in said
    assert "Traceback" not in said
    assert not script.runs


def test_memory_that_a_script_takes_has_a_limit(tmp_path: Path) -> None:
    script = Script(
        tmp_path,
        "class Mine:\n"
        "    def request(self, message):\n"
        "        if message.command == 'CurJnt':\n            self.much = bytearray(200 << 20)\n",
    )
    with proxied("--script", script.path, "-q", "--script-memory", "100") as proxy:
        assert run(*CALL, str(proxy.port), "-e", "Robot_Execute CurJnt").code == 0
        said = proxy.end()
    assert "Mine.request: MemoryError (mine.py line 6) (reported once)" in said
    assert "switched off" not in said


def test_a_longer_time_can_be_given(tmp_path: Path) -> None:
    text = "import time\nclass Mine:\n    def reply(self, message):\n        time.sleep(0.15)\n"
    script = Script(tmp_path, text)
    with proxied("--script", script.path, "-q", "--script-timeout", "5s") as proxy:
        assert run(*CALL, str(proxy.port), "Robot_Halt").code == 0
        said = proxy.end()
    assert "switched off" not in said
    assert re.search(r"Mine\.reply delayed messages by \d{3}\.\d ms \(reported once\)", said)


def test_what_a_script_does_at_the_end_has_a_limit_and_a_second_ctrl_c_waits_for_nothing(
    tmp_path: Path,
) -> None:
    script = Script(tmp_path, "import time\nclass Mine:\n    def done(self):\n        time.sleep(60)\n")
    with proxied("--script", script.path, "-q") as proxy:
        began = time.monotonic()
        said = proxy.end()
        assert time.monotonic() - began < 20
    assert "script mine.py is switched off: its process took too long at the end for done" in said
    assert not script.runs


def test_a_proxy_that_is_killed_leaves_no_script_behind(tmp_path: Path) -> None:
    script = Script(tmp_path, STUBBORN.format(body=LOOP))
    with proxied("--script", script.path, "-q") as proxy:
        assert script.runs
        proxy.kill()
        eventually(lambda: not script.runs)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_script_that_never_loads_can_be_interrupted(tmp_path: Path, number: int) -> None:
    script = Script(
        tmp_path, "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\nwhile True: pass\n"
    )
    argv = [sys.executable, "-m", "bcapscope", "proxy", "--listen", "127.0.0.1:0", "--to", "127.0.0.1:9"]
    with subprocess.Popen(
        [*argv, "--script", str(script.path)], stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert script.runs
            process.send_signal(number)
            _, err = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    assert (process.returncode, err) == (130, "")
    eventually(lambda: not script.runs)


def test_a_script_that_cannot_be_used_ends_it_before_anything_is_recorded(tmp_path: Path) -> None:
    script = Script(tmp_path, "1 / 0\n")
    path = tmp_path / "passed.pcapng"
    words = "--listen", "127.0.0.1:0", "--to", "127.0.0.1:9", "--script", script.path, "--record", path
    ran = run("proxy", *map(str, words))
    assert (ran.code, ran.err) == (
        4,
        f"{script.path}: ZeroDivisionError: division by zero (mine.py line 3)\n",
    )
    assert not path.exists()


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--script-timeout", "10.000000001s"), "10.000000001s is not a time from 1ms to 10s"),
        (("--script-timeout", "999999ns"), "999999ns is not a time from 1ms to 10s"),
        (("--script-timeout", "9" * 400), "is not a duration"),
        (("--script-memory", "9" * 400), "is not an integer from 64 to 65536"),
        (("--script-memory", "1.5"), "is not an integer"),
    ],
)
def test_limits_have_bounds(words: tuple[str, str], reason: str) -> None:
    ran = run_here("proxy", "--listen", "127.0.0.1:0", "--to", "127.0.0.1:9", *words)
    assert ran.code == 2
    assert reason in ran.err.replace("\n", " ")
