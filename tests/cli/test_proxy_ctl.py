"""`proxy ctl` against programs that are no proxy, or a hostile one."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress

import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.proxy import control_client
from bcapscope.proxy.control_messages import ProxyStats
from bcapscope.render.escape import printable
from tests.cli.run import Ran, run_here
from tests.security.harness import MEMORY_LIMIT, run_measured

HOSTILE = "a\x1b[2J\x07\r\nb\t\x00\x7f\x9b31m\u202ec\u2028d\ue000\U000e0001"

HELD = {
    "number": 1,
    "client": "10.0.0.2:50000",
    "server": "10.0.0.1:5007",
    "transport": "udp",
    "direction": "request",
    "function_id": 64,
    "function": HOSTILE,
    "command": HOSTILE,
    "waited_s": 1.5,
    "left_s": 58.5,
    "given_up": HOSTILE,
    "more": 2,
    "hex": "01 10 00 00 00 01 00 00 00 02 00 00 00 00 00 04",
}
CLIENT = {
    "number": 1,
    "client": HOSTILE,
    "server": HOSTILE,
    "transport": HOSTILE,
    "upstream": HOSTILE,
    "since_s": 1.0,
    "up": 1,
    "heard_s": None,
    "down": 1,
    "answered_s": 0.5,
}
RULE = {"name": HOSTILE, "on": True, "injected": 1, "rule": HOSTILE, "fault": {HOSTILE: HOSTILE}}
EVERYTHING = {
    "ok": True,
    "name": HOSTILE,
    "rules": [RULE],
    "held": [HELD],
    "clients": [CLIENT],
    HOSTILE: HOSTILE,
    "injected": {HOSTILE: 1},
    "refused": 0,
    "guard": True,
    "intercept": HOSTILE,
    "held_so_far": 0,
    "addon_errors": 0,
    "scripts": HOSTILE,
    "recording": HOSTILE,
    "listening": [HOSTILE],
}
STATS = {**EVERYTHING, "held": 1, "clients": 1}
COMMANDS = [
    ("rules",),
    ("add", "loss=5%"),
    ("remove", "x"),
    ("on", "x"),
    ("off", "x"),
    ("intercept",),
    ("held",),
    ("forward", "1"),
    ("edit", "1", "--hex", "01"),
    ("drop", "1"),
    ("clients",),
    ("stats",),
]


@contextmanager
def serving(answer: Callable[[socket.socket], None]) -> Iterator[str]:
    """Listen, and give each connection an answer once it has asked; yield the address."""

    def serve() -> None:
        with suppress(OSError):
            while True:
                connection, _ = server.accept()
                with connection, suppress(OSError):
                    connection.recv(1 << 20)
                    answer(connection)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"127.0.0.1:{server.getsockname()[1]}"
        server.shutdown(socket.SHUT_RDWR)
    thread.join(10)


def ctl(answer: bytes, *words: str, options: Sequence[str] = ()) -> Ran:
    """Run `proxy ctl` against a program that answers so."""
    with serving(lambda connection: connection.sendall(answer)) as address:
        return run_here("proxy", "ctl", *options, address, *words)


def is_harmless(text: str) -> bool:
    """Tell whether a terminal shows all of a text and obeys nothing in it."""
    return all(line == printable(line) for line in text.split("\n"))


@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: words[0])
def test_nothing_of_an_answer_reaches_the_terminal_unescaped(words: tuple[str, ...]) -> None:
    is_stats = words == ("stats",)
    ran = ctl(orjson.dumps(STATS if is_stats else EVERYTHING) + b"\n", *words)
    assert ran.code == 0, ran.err
    assert is_harmless(ran.out)
    assert len(ran.lines) <= (len(ProxyStats.__struct_fields__) if is_stats else 1)
    if words[0] in ("rules", "add", "held", "clients", "stats"):
        assert "a\\x1b[2J\\x07\\r\\nb" in ran.out


@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: words[0])
def test_json_is_escaped_and_stays_what_it_was(words: tuple[str, ...]) -> None:
    ran = ctl(orjson.dumps(EVERYTHING) + b"\n", *words, options=["--json"])
    assert ran.code == 0, ran.err
    assert is_harmless(ran.out)
    assert orjson.loads(ran.out) == EVERYTHING


@pytest.mark.parametrize("options", [(), ("--json",)])
def test_a_refusal_is_escaped_and_cut(options: tuple[str, ...]) -> None:
    answer = {"ok": False, "error": HOSTILE + "x" * 100_000}
    ran = ctl(orjson.dumps(answer) + b"\n", "rules", options=options)
    assert ran.code == ExitCode.REFUSED
    assert is_harmless(ran.out + ran.err)
    if options:
        assert orjson.loads(ran.out) == answer
    else:
        assert ran.err.startswith("a\\x1b[2J\\x07\\r\\nb")
        assert len(ran.err) < 1200


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(
    st.sampled_from(["rules", "held", "clients", "stats", "add"]),
    st.sampled_from(
        ["number", "client", "server", "since_s", "waited_s", "left_s", "hex", "more", "injected", ""]
    ),
    VALUES,
)
def test_values_that_no_proxy_gives_end_with_a_sentence(command: str, name: str, value: object) -> None:
    answer: dict[str, object] = {
        **EVERYTHING,
        "name": value,
        "rules": [{**RULE, name: value}] if name else value,
        "held": [{**HELD, name: value}] if name else value,
        "clients": [{**CLIENT, name: value}] if name else value,
    }
    if command == "stats":
        answer = {**STATS, name: value, "injected": value}
    ran = ctl(orjson.dumps(answer) + b"\n", command, *(["loss=5%"] if command == "add" else []))
    assert ran.code in (0, ExitCode.UNREADABLE), ran
    assert is_harmless(ran.out + ran.err)
    if ran.code:
        assert "is not a bcapscope proxy of this version" in ran.err


@pytest.mark.parametrize(
    "data", [b"HTTP/1.1 400 \x1b[2J\r\n\r\n", b"{}\n", b"null\n", b"\xff\xfe\n", b"\n", b""]
)
@pytest.mark.parametrize("options", [(), ("--json",)])
@pytest.mark.parametrize("command", ["rules", "held", "stats"])
def test_what_is_no_proxy_is_reported(data: bytes, command: str, options: tuple[str, ...]) -> None:
    ran = ctl(data, command, options=options)
    assert ran.code == ExitCode.UNREADABLE
    assert "is not a bcapscope proxy" in ran.err or "ended before it answered" in ran.err
    assert is_harmless(ran.out + ran.err)


def test_an_answer_that_comes_by_the_byte_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def drip(connection: socket.socket) -> None:
        while True:
            connection.sendall(b" ")
            time.sleep(0.02)  # the pace of the hostile server

    monkeypatch.setattr(control_client, "ANSWERS_WITHIN", 0.5)
    with serving(drip) as address:
        ran = run_here("proxy", "ctl", address, "rules")
    assert ran.code == ExitCode.UNREADABLE
    assert "no answer" in ran.err


@pytest.mark.parametrize("command", ["rules", "held", "stats"])
@pytest.mark.parametrize(
    "piece", [b"[],", b"x" * 1024, b'{"held": [' + b"[" * 1000], ids=["lists", "text", "deep"]
)
def test_an_endless_answer_ends_in_bounded_memory(command: str, piece: bytes) -> None:
    def flood(connection: socket.socket) -> None:
        connection.sendall(b'{"ok": true, "rules": [')
        while True:
            connection.sendall(piece * (65536 // len(piece)))

    with serving(flood) as address:
        ended = run_measured(["proxy", "ctl", address, command])
    assert ended.code == ExitCode.UNREADABLE
    assert "exceeds" in ended.err
    assert ended.peak < MEMORY_LIMIT


def test_the_largest_list_of_held_messages_fits_into_memory() -> None:
    one = orjson.dumps({**HELD, "hex": "00"})
    count = (control_client.LARGEST_LIST - 100) // (len(one) + 1)
    answer = b'{"ok": true, "held": [' + b",".join([one] * count) + b"]}\n"
    with serving(lambda connection: connection.sendall(answer)) as address:
        ended = run_measured(["proxy", "ctl", address, "held"])
    assert ended.code == 0, ended.err
    assert ended.peak < MEMORY_LIMIT
