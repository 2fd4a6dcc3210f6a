"""Asking a proxy, and what may stand in its place."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress

import orjson
import pytest

from bcapscope.messages.message import foreign_text
from bcapscope.proxy import control_client
from bcapscope.proxy import control_messages as control
from bcapscope.proxy.control_api import ControlApi
from bcapscope.proxy.control_client import ControlClient, ControlRefused
from bcapscope.proxy.control_messages import LONGEST_LINE
from bcapscope.proxy.control_socket import ControlError, ControlServer
from bcapscope.transport.socket_link import close_with_reset
from tests.proxy.relaying import PATIENCE
from tests.proxy.test_control_socket import Watcher
from tests.proxy.test_rule_policy import rules


def test_one_connection_serves_all_questions() -> None:
    with (
        Watcher() as watcher,
        closing(ControlServer("127.0.0.1:0", ControlApi(rules("drop")), watcher)) as server,
        closing(ControlClient(server.address)) as client,
    ):
        assert [rule.name for rule in client.request(control.ListFaults(), control.FaultsResponse).rules] == [
            "drop"
        ]
        with pytest.raises(ControlRefused, match="no fault is named 'x': drop") as refused:
            client.request(control.EnableFault("x"), control.FaultResponse)
        assert orjson.loads(refused.value.line)["ok"] is False
        assert client.request(control.DisableFault("drop"), control.FaultResponse).name == "drop"


def test_nobody_is_there() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"127.0.0.1:{free.getsockname()[1]}"
    with closing(ControlClient(address)) as client, pytest.raises(ControlError, match="no proxy listens"):
        client.request(control.GetStats(), control.ProxyStats)


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (b"", "ended before it answered"),
        (b"SSH-2.0-x\n", "is not a bcapscope proxy"),
        (b'{"ok"', "ended before"),
        (b"[]\n", "is not a bcapscope proxy"),
        (b'{"ok": 1}\n', "is not a bcapscope proxy"),
        (b'{"ok": true, "x": ' + b"[" * 50_000 + b"\n", "is not a bcapscope proxy"),
        (b'{"ok": true, "x": 1e999}\n', "is not a bcapscope proxy"),
        (b'{"ok": true, "x": "\xff"}\n', "is not a bcapscope proxy"),
        (b'{"ok": true}\n{"ok": true}\n', "is not a bcapscope proxy"),
        (b"[" * (LONGEST_LINE + 1), "exceeds 1 MB"),
    ],
)
def test_somebody_else_is_there(answer: bytes, reason: str) -> None:
    with _answering(answer) as address, closing(ControlClient(address)) as client:
        for _ in range(2):  # and it goes on: the proxy may come back
            with pytest.raises(ControlError, match=reason):
                client.request(control.GetStats(), control.ProxyStats)


@pytest.mark.parametrize(("size", "is_read"), [(16 << 20, True), ((16 << 20) + 1, False)])
def test_a_list_of_held_messages_has_at_most_16_mb(size: int, is_read: bool) -> None:
    answer = b'{"ok":true,"held":[]'.ljust(size - 2) + b"}\n"
    with _answering(answer) as address, closing(ControlClient(address)) as client:
        for _ in range(2):
            if is_read:
                assert client.request(control.ListHeld(), control.HeldResponse).held == []
                client.close()
            else:
                with pytest.raises(ControlError, match="exceeds 16 MB"):
                    client.request(control.ListHeld(), control.HeldResponse)


def test_after_a_reset_it_connects_again() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENCE)

        def reset_twice() -> None:
            for _ in range(2):
                connection, _address = server.accept()
                connection.recv(1000)
                close_with_reset(connection)

        thread = threading.Thread(target=reset_twice, daemon=True)
        thread.start()
        with closing(ControlClient(f"127.0.0.1:{server.getsockname()[1]}")) as client:
            for _ in range(2):
                with pytest.raises(ControlError, match=r"has ended$"):
                    client.request(control.GetStats(), control.ProxyStats)
        thread.join(PATIENCE)
        assert not thread.is_alive()


def test_an_answer_that_comes_too_slowly_is_not_awaited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control_client, "ANSWERS_WITHIN", 0.3)
    given_up = threading.Event()

    def drip() -> None:
        connection, _address = server.accept()
        with connection, suppress(OSError):
            while not given_up.wait(0.05):
                connection.sendall(b" ")

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=drip)
        thread.start()
        with closing(ControlClient(f"127.0.0.1:{server.getsockname()[1]}")) as client:
            with pytest.raises(ControlError, match="no answer"):
                client.request(control.GetStats(), control.ProxyStats)
            given_up.set()
        thread.join(PATIENCE)


@pytest.mark.parametrize(("size", "shown"), [(1000, 1000), (1001, 1001), (5000, 1001)])
def test_a_long_reason_is_cut(size: int, shown: int) -> None:
    reason = str(ControlRefused(foreign_text("x" * size), b""))
    assert len(reason) == shown
    assert reason.endswith("…") is (size > 1000)


@contextmanager
def _answering(answer: bytes) -> Iterator[str]:
    """Listen twice, and answer whatever comes."""

    def serve() -> None:
        for _ in range(2):
            connection, _address = server.accept()
            with connection:
                connection.recv(1000)
                connection.sendall(answer)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve)
        thread.start()
        yield f"127.0.0.1:{server.getsockname()[1]}"
        thread.join(10)
