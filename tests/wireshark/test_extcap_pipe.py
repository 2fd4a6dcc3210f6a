"""Captures into a pipe that is read as Wireshark reads it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path

import pytest

import bcapscope
from tests.cli.run import run
from tests.wireshark.extcap_capturing import (
    PATIENCE,
    free_port,
    is_free,
    processes_with,
    wait_for_reply,
)

pytestmark = [
    pytest.mark.lifecycle,
    pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes"),
]


class PipeCapture:
    """A capture interface that writes to a pipe.

    Attributes:
        popen: the process.
        reader: the reading end.
    """

    def __init__(self, pipe: Path, name: str, *options: str) -> None:
        os.mkfifo(pipe)
        words = ["extcap", "--capture", "--extcap-interface", name, "--fifo", str(pipe), *options]
        argv = [sys.executable, "-m", "bcapscope", *words]
        self.popen = subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        self.reader = FileIO(os.open(pipe, os.O_RDONLY), "rb")

    def read_until(self, data: bytes) -> bytes:
        read = b""
        while data not in read:
            more = self.reader.read(65536)
            assert more, self.popen.communicate()
            read += more
        return read

    def end(self) -> tuple[int, bytes, bytes]:
        out, err = self.popen.communicate(timeout=PATIENCE)
        return self.popen.returncode, out, err


@contextmanager
def capturing(folder: Path, name: str, *options: str) -> Iterator[PipeCapture]:
    capture = PipeCapture(folder / "pipe", name, *options)
    try:
        yield capture
    finally:
        capture.popen.kill()
        capture.popen.communicate()
        capture.reader.close()


@contextmanager
def capturing_proxy(folder: Path, port: int) -> Iterator[PipeCapture]:
    with bcapscope.Simulator() as simulator:
        to = f"{simulator.host}:{simulator.port}"
        options = ("--to", to, "--listen", f"127.0.0.1:{port}")
        with capturing(folder, "bcapscope-proxy", *options) as capture:
            yield capture


def test_the_reader_sees_a_call_at_once_and_its_end_is_the_end(tmp_path: Path) -> None:
    port = free_port()
    with capturing(tmp_path, "bcapscope-sim", "--port", str(port)) as capture:
        wait_for_reply(port)
        answered = time.monotonic()
        capture.read_until(b",\0W\0D\0T\0")
        assert time.monotonic() - answered < 1
        capture.reader.close()
        assert capture.end() == (0, b"", b"")
    assert is_free(port)
    assert processes_with(str(tmp_path)) == []


def test_a_proxy_ends_at_the_signal_of_wireshark_with_a_whole_capture(tmp_path: Path) -> None:
    port = free_port()
    with capturing_proxy(tmp_path, port) as capture:
        wait_for_reply(port)
        read = capture.read_until(b",\0W\0D\0T\0")
        capture.popen.send_signal(signal.SIGTERM)
        read += capture.reader.readall()
        assert capture.end() == (0, b"", b"")
    recording = tmp_path / "read.pcapng"
    recording.write_bytes(read)
    done = run("decode", "--side", "controller", recording)
    functions = [
        function for line in done.lines for function in ("Service_Start", "Service_Stop") if function in line
    ]
    # The proxy has stopped the service that the client left open.
    assert (done.code, functions[0], functions[-1]) == (0, "Service_Start", "Service_Stop")
    assert is_free(port)
    assert processes_with(str(tmp_path)) == []


def test_a_signal_after_the_pipe_was_closed_does_not_hasten_the_end(tmp_path: Path) -> None:
    port = free_port()
    with bcapscope.Simulator() as simulator:
        options = ("--to", f"{simulator.host}:{simulator.port}", "--listen", f"127.0.0.1:{port}")
        with capturing(tmp_path, "bcapscope-proxy", *options) as capture:
            wait_for_reply(port)
            capture.read_until(b",\0W\0D\0T\0")
            capture.reader.close()
            for number in (signal.SIGINT, signal.SIGTERM):
                capture.popen.send_signal(number)
            assert capture.end() == (0, b"", b"")
        functions = [call.kind.function_id for call in simulator.calls]
    assert functions == [1, 2]
    assert processes_with(str(tmp_path)) == []


def test_wireshark_that_is_killed_before_it_reads_leaves_nothing(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    argv = [sys.executable, "-m", "bcapscope", "extcap", "--capture", "--extcap-interface", "bcapscope-sim"]
    with subprocess.Popen([*argv, "--fifo", str(pipe), "--port", "0"], stderr=subprocess.PIPE) as popen:
        os.close(os.open(pipe, os.O_RDONLY))  # opens as soon as the command has opened its end
        assert popen.communicate(timeout=PATIENCE)[1] == b""
        assert popen.returncode == 0
    assert processes_with(str(tmp_path)) == []


@pytest.mark.parametrize(
    ("name", "options", "reason", "code"),
    [
        ("bcapscope-sim", ["--port", "{taken}"], "cannot listen on 127.0.0.1", 4),
        ("bcapscope-proxy", ["--to", "127.0.0.1:1", "--listen", "127.0.0.1:{taken}"], "cannot listen on ", 4),
        ("bcapscope-proxy", ["--to", "127.0.0.1:1", "--fault", "los=5%"], "Invalid value for '--fault'", 2),
        ("bcapscope-proxy", [], "Controller (--to) is missing", 2),
        ("bcapscope-sim", ["--port", "70000"], "Invalid value for '-p' / '--port'", 2),
        ("bcapscope-sim", ["--scenario-file", "/nowhere.yaml"], "Invalid value for '--scenario'", 2),
    ],
)
def test_a_failure_is_told_and_ends_the_pipe(
    name: str, options: list[str], reason: str, code: int, tmp_path: Path
) -> None:
    with bcapscope.Simulator() as simulator:
        words = [each.format(taken=simulator.port) for each in options]
        with capturing(tmp_path, name, *words) as capture:
            assert capture.reader.readall() == b""
            ended, out, err = capture.end()
    assert (ended, out) == (code, b"")
    assert err.decode().startswith(reason)
    assert b"Traceback" not in err
    assert processes_with(str(tmp_path)) == []


def test_a_simulator_that_is_killed_is_an_error(tmp_path: Path) -> None:
    port = free_port()
    with capturing(tmp_path, "bcapscope-sim", "--port", str(port)) as capture:
        wait_for_reply(port)
        (child,) = set(processes_with(str(tmp_path))) - {capture.popen.pid}
        os.kill(child, signal.SIGKILL)
        assert capture.end() == (1, b"", b"the proxy or simulator was killed\n")
    assert is_free(port)


def test_a_missing_pipe_is_an_error(tmp_path: Path) -> None:
    done = run(
        "extcap", "--capture", "--extcap-interface", "bcapscope-sim", "--fifo", tmp_path / "no", "--port=0"
    )
    assert done.code == 6
    assert "no such file" in done.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["proxy", "sim"])
def test_a_recording_can_go_to_a_pipe(command: str, tmp_path: Path) -> None:
    pipe, port = tmp_path / "pipe", free_port()
    os.mkfifo(pipe)
    with bcapscope.Simulator() as simulator:
        options = ["--listen", f"127.0.0.1:{port}", "--to", f"{simulator.host}:{simulator.port}"]
        words = ["proxy", *options] if command == "proxy" else ["sim", "--port", str(port)]
        argv = [sys.executable, "-m", "bcapscope", *words, "--quiet", "--record", str(pipe)]
        with subprocess.Popen(argv, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE) as popen:
            with pipe.open("rb", buffering=0) as reader:
                wait_for_reply(port)
                assert reader.read(4) == b"\x0a\x0d\x0d\x0a"
                popen.send_signal(signal.SIGTERM)
                reader.read()
            popen.communicate(timeout=PATIENCE)
            assert popen.returncode == 0
