"""Commands that the screen starts."""

from __future__ import annotations

import os
import signal
import socket
import threading

import pytest

from bcapscope.live.child_process import ChildProcess, ChildStartError
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant

pytestmark = pytest.mark.lifecycle

LIMIT = 60.0
SERVICE_START = encode_frame(1, 0, 1, [Variant(VT.BSTR, "")])


def test_a_command_tells_where_it_listens_and_ends_in_order() -> None:
    child = ChildProcess("sim", "--port", "0", "--quiet")
    try:
        (address,) = child.listen_addresses
        host, _, port = address.rpartition(":")
        with socket.socket(type=socket.SOCK_DGRAM) as client:
            client.settimeout(LIMIT)
            client.sendto(SERVICE_START, (host, int(port)))
            assert Frame(client.recv(1000)).serial == 1
    finally:
        said = child.terminate()
    assert said[-1].startswith("1 calls")
    assert not [line for line in said if "Traceback" in line]


def test_a_command_that_cannot_listen_says_why() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ChildStartError, match=f"cannot listen on 127.0.0.1 TCP port {port}") as raised:
            ChildProcess("sim", "--port", f"{port}", "--quiet")
    assert raised.value.code == 4


def test_a_command_that_is_killed_is_noticed_and_what_it_said_before_is_told() -> None:
    child, over = ChildProcess("sim", "--port", "0"), threading.Event()
    reasons: list[str] = []
    lines: list[str] = []

    def ended(reason: str) -> None:
        reasons.append(reason)
        over.set()

    try:
        child.subscribe_output(lines.append)
        assert any("only this machine can connect" in line for line in lines)
        child.subscribe_end(ended)
        os.kill(child.pid, signal.SIGKILL)
        assert over.wait(LIMIT)
        assert reasons == [""]
        child.subscribe_end(ended)
        assert reasons == ["", ""]
    finally:
        assert child.terminate() == []


def test_it_ends_when_the_one_who_started_it_is_gone() -> None:
    child, over = ChildProcess("sim", "--port", "0", "--quiet"), threading.Event()
    try:
        child.subscribe_end(lambda reason: over.set())
        assert child._process.stdin is not None
        child._process.stdin.close()  # as the system does when the screen is killed
        assert over.wait(LIMIT)
    finally:
        child.terminate()
