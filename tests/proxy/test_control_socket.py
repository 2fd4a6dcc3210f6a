"""The control socket: who can open it, what comes back, and what is no client of ours."""

from __future__ import annotations

import errno
import gc
import json
import os
import socket
import stat
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path

import pytest

from bcapscope.proxy import control_socket
from bcapscope.proxy.control_api import ControlApi
from bcapscope.proxy.control_messages import LONGEST_LINE
from bcapscope.proxy.control_socket import (
    MAX_CONNECTIONS,
    ControlError,
    ControlServer,
    connect_control,
    is_tcp_address,
)
from bcapscope.proxy.poller import READ, DescriptorWatcher, Handler
from bcapscope.transport.socket_link import close_with_reset
from tests.proxy.relaying import eventually
from tests.proxy.test_rule_policy import rules

unix_only = pytest.mark.skipif(
    sys.platform == "win32", reason="there are no Unix sockets in Python on Windows"
)


class Watcher(DescriptorWatcher):
    """Waits for descriptors, as the relay does, in a thread."""

    def __init__(self) -> None:
        super().__init__()
        self.paused: list[int] = []
        self._ends = False
        self._thread = threading.Thread(target=self._run)

    def pause(self, descriptor: int) -> None:
        super().pause(descriptor)
        self.paused.append(descriptor)

    def __enter__(self) -> Watcher:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends = True
        self._thread.join()

    def close(self) -> None:
        self._poller.close()

    def _run(self) -> None:
        while not self._ends:
            for descriptor, happened in self._poller.poll(0.01):
                if descriptor in self._handlers:
                    self._handlers[descriptor](happened)
            self._adopt_new_handlers()


@contextmanager
def server(address: str) -> Iterator[ControlServer]:
    """Run a control socket for the length of a block."""
    watcher = Watcher()
    try:
        made = ControlServer(address, ControlApi(rules("loss=5%")), watcher)
        with watcher:
            yield made
        made.close()
    finally:
        watcher.close()


def refused(address: str, reason: str) -> None:
    """Check that there can be no control socket."""
    with pytest.raises(ControlError, match=reason), server(address):
        pass


@pytest.fixture(params=["path", "port"])
def address(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Give an address of either kind."""
    if request.param == "port":
        return "127.0.0.1:0"
    if sys.platform == "win32":
        pytest.skip("there are no Unix sockets in Python on Windows")
    return str(tmp_path / "ctl.sock")


def ask(sock: socket.socket, *lines: bytes) -> list[dict[str, object]]:
    """Send lines, read as many answers."""
    sock.sendall(b"".join(lines))
    with sock.makefile("rb") as answers:
        return [json.loads(answers.readline()) for _ in lines]


def test_lines_are_answered_one_by_one(address: str) -> None:
    with (
        server(address) as made,
        connect_control(made.address) as one,
        connect_control(made.address) as other,
    ):
        first, second = ask(one, b'{"do": "rules"}\n', b'{"do": "off", "name": "drop"}\n')
        assert first["ok"]
        assert second == {"ok": True, "name": "drop"}
        one.sendall(b'{"do": ')
        assert (
            ask(other, b'\n{"do": "on", "name": "x"}\n'.lstrip())[0]["error"] == "no fault is named 'x': drop"
        )
        assert ask(one, b'"stats"}\n')[0]["struck"] == {"drop": 0}


def test_a_long_answer_comes_whole(address: str) -> None:
    with server(address) as made, connect_control(made.address) as sock:
        asked = 3000
        thread = threading.Thread(target=sock.sendall, args=(b'{"do": "rules"}\n' * asked,))
        thread.start()
        with sock.makefile("rb") as answers:
            assert {answers.readline() for _ in range(asked)} != {b""}
        thread.join()


def test_of_who_asks_and_does_not_listen_one_answer_is_kept_however_long(address: str) -> None:
    class Talkative(ControlApi):
        asked = 0

        def handle_line(self, line: bytes, now: int) -> tuple[bytes, bool]:
            self.asked += 1
            return b"x" * (16 << 20) + b"\n", True

    api, watcher = Talkative(rules()), Watcher()
    with (
        closing(watcher),
        closing(ControlServer(address, api, watcher)) as made,
        watcher,
        connect_control(made.address) as sock,
        connect_control(made.address) as other,
    ):
        sock.sendall(b"{}\n" * 9)
        eventually(lambda: api.asked == 1)
        other.sendall(b"{}\n")
        eventually(lambda: api.asked == 2)
        with sock.makefile("rb") as answers:
            assert len(answers.readline()) == (16 << 20) + 1
        eventually(lambda: api.asked == 3)


def test_who_does_not_speak_json_is_sent_away(address: str) -> None:
    with server(address) as made, connect_control(made.address) as sock:
        sock.sendall(b'POST / HTTP/1.1\r\nHost: x\r\n\r\n{"do": "remove", "name": "drop"}\n')
        with sock.makefile("rb") as answers:
            assert b"this is not JSON" in answers.readline()
            assert answers.read() == b""
        with connect_control(made.address) as again:
            assert ask(again, b'{"do": "rules"}\n')[0]["rules"] != []


def test_a_line_without_end_is_not_read_for_ever(address: str) -> None:
    with server(address) as made, connect_control(made.address) as sock:
        with suppress(ConnectionError):
            sock.sendall(b" " * (LONGEST_LINE + 200_000))
            assert sock.recv(1) == b""
        with connect_control(made.address) as again:
            assert ask(again, b'{"do": "rules"}\n')[0]["ok"]


def test_there_are_only_so_many_connections(address: str) -> None:
    with server(address) as made:
        open_ones = [connect_control(made.address) for _ in range(MAX_CONNECTIONS)]
        assert all(ask(sock, b'{"do": "rules"}\n')[0]["ok"] for sock in open_ones)
        with connect_control(made.address) as sock, sock.makefile("rb") as answers:
            assert answers.read() == b""
        for sock in open_ones:
            sock.close()


def test_connections_without_a_command_make_room(address: str) -> None:
    with server(address) as made, ExitStack() as stack:
        asked = stack.enter_context(connect_control(made.address))
        assert ask(asked, b'{"do": "rules"}\n')[0]["ok"]
        for _ in range(3 * MAX_CONNECTIONS):
            stack.enter_context(connect_control(made.address))
        late = stack.enter_context(connect_control(made.address))
        for sock in (late, asked):
            assert ask(sock, b'{"do": "rules"}\n')[0]["ok"]


def test_an_idle_connection_makes_room_when_all_have_asked(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with server(address) as made, ExitStack() as stack:
        socks = [stack.enter_context(connect_control(made.address)) for _ in range(MAX_CONNECTIONS)]
        assert all(ask(sock, b'{"do": "rules"}\n')[0]["ok"] for sock in socks)
        monkeypatch.setattr(control_socket, "IDLE_AFTER", 0.0)
        late = stack.enter_context(connect_control(made.address))
        assert ask(late, b'{"do": "rules"}\n')[0]["ok"]
        assert socks[0].recv(1) == b""


def test_without_file_descriptors_who_asks_waits_and_the_relay_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def none_left(_: socket.socket) -> None:
        raise OSError(errno.EMFILE, "")

    watcher = Watcher()
    with closing(watcher), closing(ControlServer("127.0.0.1:0", ControlApi(rules()), watcher)) as made:
        monkeypatch.setattr(socket.socket, "accept", none_left)
        with watcher, connect_control(made.address):
            eventually(lambda: watcher.paused)
        assert len(watcher.paused) == 1


@unix_only
def test_only_its_user_opens_the_file_and_it_is_gone_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "ctl.sock"
    with server(str(path)):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        refused(str(path), "another proxy listens for control on")
    assert not path.exists()


@unix_only
def test_the_file_of_a_proxy_that_was_killed_is_taken_over(tmp_path: Path) -> None:
    path = str(tmp_path / "ctl.sock")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as left:
        left.bind(path)
    with server(path) as made, connect_control(made.address) as sock:
        assert ask(sock, b'{"do": "rules"}\n')[0]["ok"]


@pytest.mark.parametrize(
    ("address", "reason"),
    [
        ("0.0.0.0:5999", "0.0.0.0 is not on loopback"),
        ("192.168.0.1:5999", "192.168.0.1 is not on loopback"),
        ("localhost:5999", "localhost is not an IP address"),
        ("127.0.0.1:99999", "cannot listen for control on 127.0.0.1:99999: "),
        ("/no/such/folder/ctl.sock", "no such file|No such file"),
        ("x" * 200, "cannot listen for control"),
    ],
)
def test_an_address_that_will_not_do_is_refused(address: str, reason: str) -> None:
    refused(address, reason)


@unix_only
def test_files_made_later_have_the_modes_of_their_maker(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        with server(str(tmp_path / "ctl.sock")):
            (tmp_path / "later").touch()
        assert stat.S_IMODE((tmp_path / "later").stat().st_mode) == 0o644
    finally:
        os.umask(before)


def test_a_port_can_be_listened_on_again_at_once(address: str) -> None:
    with server(address) as made:
        taken = made.address
        sock = connect_control(taken)
        assert ask(sock, b'{"do": "rules"}\n')[0]["ok"]
    sock.close()
    with server(taken) as made, connect_control(made.address) as again:
        assert ask(again, b'{"do": "rules"}\n')[0]["ok"]


def test_a_connection_that_was_reset_is_forgotten(address: str) -> None:
    with server(address) as made:
        sock = connect_control(made.address)
        sock.sendall(b'{"do": "rules"}\n' * 3)
        eventually(lambda: made.connections)
        if sock.family == socket.AF_INET:
            close_with_reset(sock)
        else:
            sock.close()
        eventually(lambda: not made.connections)


def test_a_client_that_has_vanished_keeps_nobody_waiting(address: str) -> None:
    class Handlers(DescriptorWatcher):
        def __init__(self) -> None:
            super().__init__()
            self.accept: Handler = lambda _: None

        def watch(self, descriptor: int, handler: Handler, mask: int = READ) -> None:
            self.accept = handler
            super().watch(descriptor, handler, mask)

    watcher = Handlers()
    with closing(ControlServer(address, ControlApi(rules()), watcher)) as made:
        watcher.accept(READ)
        assert not made.connections


@pytest.mark.skipif(not socket.has_ipv6, reason="IPv6 is missing")
def test_control_on_ipv6() -> None:
    with server("[::1]:0") as made, connect_control(made.address) as sock, sock.makefile("rb") as answers:
        assert made.address == f"[::1]:{sock.getpeername()[1]}"
        sock.sendall(b'{"do": "rules"}\n')
        assert json.loads(answers.readline())["ok"]


def test_an_empty_line_before_the_first_request_is_ignored(address: str) -> None:
    with server(address) as made, connect_control(made.address) as sock, sock.makefile("rb") as answers:
        sock.sendall(b'\n{"do": "rules"}\n')
        assert json.loads(answers.readline())["ok"]


def test_another_file_is_not_taken_away(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("mine")
    refused(str(path), "exists and is not a socket")
    assert path.read_text() == "mine"


def test_a_client_does_not_wait_for_ever(address: str) -> None:
    with server(address) as made, connect_control(made.address, 7.5) as sock:
        assert sock.gettimeout() == 7.5


def test_nobody_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(ControlError, match="no such file"):
        connect_control(str(tmp_path / "none"))
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        with pytest.raises(ControlError, match="connection refused"):
            connect_control("127.0.0.1:%d" % sock.getsockname()[1])


@pytest.mark.parametrize(
    ("address", "port"),
    [("127.0.0.1:5999", True), ("[::1]:5999", True), ("./a:5", False), ("ctl.sock", False), ("a:b", False)],
)
def test_ports_and_paths_are_told_apart(address: str, port: bool) -> None:
    assert is_tcp_address(address) is port


def test_nothing_is_left_open(tmp_path: Path) -> None:
    gc.collect()  # of what earlier tests left
    before = len(os.listdir("/proc/self/fd")) if sys.platform == "linux" else 0
    for _ in range(3):
        with server("127.0.0.1:0") as made, connect_control(made.address):
            pass
    assert (len(os.listdir("/proc/self/fd")) if sys.platform == "linux" else 0) == before
