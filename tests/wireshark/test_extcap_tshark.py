"""tshark captures from the simulator and the proxy of bcapscope, as Wireshark does."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest

import bcapscope
from tests.cli.run import CAPTURES, run
from tests.proxy.relaying import eventually
from tests.wireshark.extcap_capturing import (
    PATIENCE,
    call_until_ended,
    free_port,
    is_free,
    processes_with,
    wait_for_reply,
)
from tests.wireshark.tshark import needs_tshark

pytestmark = [needs_tshark, pytest.mark.lifecycle]

PACKETS = 20
INFO = ("-T", "fields", "-e", "_ws.col.Info")


@pytest.fixture
def home(tmp_path: Path) -> Mapping[str, str]:
    """Return the environment of a user who has just installed the interfaces."""
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith(("WIRESHARK", "XDG_"))
    }
    environment |= {"HOME": str(tmp_path), "TMPDIR": str(tmp_path)}
    assert run("wireshark", "--install", HOME=str(tmp_path), XDG_CONFIG_HOME="").code == 0
    return environment


@contextmanager
def capture(environment: Mapping[str, str], *words: str) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        ["tshark", *words], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as tshark:
        try:
            yield tshark
        finally:
            tshark.kill()  # a test that failed must not wait for tshark


def simulator_options(port: int) -> list[str]:
    return ["-i", "bcapscope-sim", "-o", f"extcap.bcapscope_sim.port:{port}"]


def ended_cleanly(tshark: subprocess.Popen[str], port: int) -> list[str]:
    """Wait for the end of tshark, check that nothing is left, and return the lines that it printed."""
    out, err = tshark.communicate(timeout=PATIENCE)
    assert tshark.returncode == 0, err
    assert "rror" not in err
    assert "Traceback" not in err
    eventually(lambda: is_free(port), "the end of the server")
    assert processes_with(f"{port}") == []
    return out.splitlines()


def test_tshark_lists_the_interfaces(home: Mapping[str, str]) -> None:
    listed = subprocess.run(["tshark", "-D"], env=home, capture_output=True, check=True, text=True).stdout
    assert re.findall(r"(?m)^\d+\. (bcapscope-.*)$", listed) == [
        "bcapscope-proxy (b-CAP proxy)",
        "bcapscope-sim (b-CAP simulator)",
    ]
    assert run("wireshark", "--uninstall", HOME=home["HOME"], XDG_CONFIG_HOME="").code == 0
    listed = subprocess.run(["tshark", "-D"], env=home, capture_output=True, check=True, text=True).stdout
    assert "bcapscope" not in listed


@pytest.mark.skipif(os.geteuid() == 0, reason="Wireshark ignores WIRESHARK_EXTCAP_DIR for root")
def test_a_folder_of_the_user_has_the_launcher_in_its_subfolder(tmp_path: Path) -> None:
    assert run("wireshark", "--install", "--folder", tmp_path).code == 0
    environment = {**os.environ, "HOME": "/nowhere", "WIRESHARK_EXTCAP_DIR": str(tmp_path / "extcap")}
    done = subprocess.run(["tshark", "-D"], env=environment, capture_output=True, check=True, text=True)
    assert "bcapscope-sim" in done.stdout


def test_tshark_captures_from_the_simulator(home: Mapping[str, str]) -> None:
    port = free_port()
    with capture(home, *simulator_options(port), "-c", str(PACKETS), *INFO) as tshark:
        call_until_ended(tshark, port)
        lines = ended_cleanly(tshark, port)
    assert {re.sub(r"\d+", "N", line) for line in lines} == {
        "Request N Service_Start",
        "Reply N S_OK to Service_Start",
    }
    assert len(lines) == PACKETS


def test_tshark_captures_both_sides_of_the_proxy(home: Mapping[str, str]) -> None:
    port = free_port()
    with bcapscope.Simulator() as simulator:
        options = [f"to:{simulator.host}:{simulator.port}", f"listen:127.0.0.1:{port}"]
        words = [word for each in options for word in ("-o", f"extcap.bcapscope_proxy.{each}")]
        with capture(home, "-i", "bcapscope-proxy", *words, "-c", str(PACKETS), *INFO) as tshark:
            call_until_ended(tshark, port)
            lines = ended_cleanly(tshark, port)
    assert {lines.count(line) for line in lines[:8]} == {2}
    assert {re.sub(r"\d+", "N", line) for line in lines} == {
        "Request N Service_Start",
        "Reply N S_OK to Service_Start",
    }
    assert len(lines) == PACKETS


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_the_capture_ends_with_tshark(number: int, home: Mapping[str, str]) -> None:
    port = free_port()
    with capture(home, *simulator_options(port), "-l", *INFO) as tshark:
        wait_for_reply(port)
        assert tshark.stdout is not None
        assert tshark.stdout.readline() == "Request 7 Service_Start\n"
        tshark.send_signal(number)
        tshark.communicate(timeout=PATIENCE)
    eventually(lambda: is_free(port), "the end of the server")
    eventually(lambda: not processes_with(f"{port}"), "the end of its processes")


def test_tshark_shows_why_a_capture_failed(home: Mapping[str, str]) -> None:
    with bcapscope.Simulator() as simulator, capture(home, *simulator_options(simulator.port)) as tshark:
        _, err = tshark.communicate(timeout=PATIENCE)
    assert tshark.returncode != 0
    assert f"cannot listen on 127.0.0.1 TCP port {simulator.port}: address already in use" in err


PAGE = (CAPTURES.parent / "docs" / "wireshark.md").read_text(encoding="utf-8")
COMMANDS = [
    line for block in re.findall(r"(?ms)^```sh\n(.*?)^```$", PAGE) for line in block.splitlines() if line
]


@pytest.mark.parametrize("line", COMMANDS)
def test_the_commands_of_the_page_capture(line: str, home: Mapping[str, str]) -> None:
    port = free_port()
    with bcapscope.Simulator() as simulator:
        there = line.replace("192.168.0.1:5007", f"{simulator.host}:{simulator.port}").replace(
            "6007", str(port)
        )
        program, *words = shlex.split(there)
        assert program == "tshark"
        assert there != line
        with capture(home, *words) as tshark:
            call_until_ended(tshark, port)
            ended_cleanly(tshark, port)


def test_the_page_has_commands() -> None:
    assert len(COMMANDS) == 2
