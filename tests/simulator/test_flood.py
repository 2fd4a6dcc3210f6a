"""Clients that flood: a good one is answered meanwhile and afterwards, and nothing grows."""

from __future__ import annotations

import multiprocessing
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random
from typing import Self

import pytest

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.simulator.argument_values import bstr, i4

SECONDS = 2.0
START = encode_frame(1, 0, 1, [bstr("")])
TRIES, PATIENCE = 5, 1.0
"""Of a call that is no set point (DENSO Wave 2009, How to use the Slave mode): once, and four times again."""

MAX_GROWTH = 80 << 20
"""Bytes: twenty connections may leave a megabyte unread each, and 16 MiB of packets wait for the disk."""


def garbage(port: int, until: float) -> None:
    """Send datagrams that are no requests from three sources, as fast as can be."""
    chance = Random(1)
    framed = [b"\x01" + (120).to_bytes(4, "little") + chance.randbytes(114) + b"\x04" for _ in range(4)]
    bad = (b"", b"\x01" * 40, b"\x01" + bytes(600), START[:-1], chance.randbytes(400), *framed)
    socks = [socket.socket(type=socket.SOCK_DGRAM) for _ in range(3)]
    for sock in socks:
        sock.connect(("127.0.0.1", port))
        sock.setblocking(False)
    while time.monotonic() < until:
        for each in bad:
            for sock in socks:
                try:
                    sock.send(each)
                except OSError:
                    continue


def lazy(port: int, until: float) -> None:
    """Ask for much over TCP, read nothing; come and go; leave some connections half a request."""
    asked = START + encode_frame(2, 0, 3, [bstr(""), bstr("CaoProv.DENSO.VRC"), bstr(""), bstr("")])
    asked += encode_frame(3, 0, 15, [i4(1), bstr("")]) * 300
    socks: list[socket.socket] = []
    while time.monotonic() < until:
        try:
            sock = socket.create_connection(("127.0.0.1", port), 1)
        except OSError:
            continue
        sock.setblocking(False)
        socks.append(sock)
        for each in socks:
            try:
                each.send(asked if len(socks) % 3 else START[:20])
            except OSError:
                continue
        if len(socks) > 18:
            socks.pop(0).close()


def idle(port: int, until: float) -> None:
    """Connect and say nothing."""
    socks = [socket.create_connection(("127.0.0.1", port), 5) for _ in range(5)]
    time.sleep(max(0.0, until - time.monotonic()))
    for sock in socks:
        sock.close()


@contextmanager
def simulator(record: Path) -> Iterator[tuple[int, int]]:
    """Run `bcapscope sim`, which records and whose log nobody reads; yield its process and its port."""
    argv = [sys.executable, "-m", "bcapscope", "sim", "--port", "0", "--attended", "--record", str(record)]
    pipe = subprocess.PIPE
    with subprocess.Popen(argv, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        try:
            port = int(process.stdout.readline().split(b'"')[3].rpartition(b":")[2])
            yield process.pid, port
        finally:
            process.kill()


class Good:
    """A client with the seed's retries."""

    def __init__(self, port: int) -> None:
        self.sock = socket.socket(type=socket.SOCK_DGRAM)
        self.sock.connect(("127.0.0.1", port))
        self.serial = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.sock.close()

    def call(self) -> int:
        """Call once; return how many retries it took."""
        first = self.serial + 1
        for retry in range(TRIES):
            self.serial += 1
            reserved = first if retry else 0
            self.sock.send(encode_frame(self.serial, reserved, 1, [bstr("")]))
            end = time.monotonic() + PATIENCE
            while (left := end - time.monotonic()) > 0:
                self.sock.settimeout(left)
                try:
                    frame = Frame(self.sock.recv(4096))
                except TimeoutError:
                    break
                if frame.serial == self.serial:
                    assert frame.code == 0
                    return retry
        raise AssertionError(f"no answer to {TRIES} requests")


def memory(pid: int) -> int:
    """Return the bytes of memory that a process has."""
    fields = Path(f"/proc/{pid}/statm").read_text().split()
    return int(fields[1]) * 4096


def wait_until_read(port: int) -> None:
    """Wait until the datagrams that a flood has left at a port are read, which leave no room for others."""
    until = time.monotonic() + 20
    while any(waiting for at, waiting in unread_datagrams() if at == port):
        assert time.monotonic() < until
        time.sleep(0.01)


def unread_datagrams() -> Iterator[tuple[int, int]]:
    """Give out the port of each UDP socket and the bytes that wait to be read from it."""
    for line in Path("/proc/net/udp").read_text().splitlines()[1:]:
        _, local, _, _, queues, *_ = line.split()
        yield int(local.rpartition(":")[2], 16), int(queues.rpartition(":")[2], 16)


@pytest.mark.parametrize("flood", [(garbage,), (lazy, idle), (garbage, lazy)])
def test_a_good_client_is_answered_beside_a_flood(
    flood: tuple[Callable[[int, float], None], ...], tmp_path: Path
) -> None:
    with simulator(tmp_path / "a.pcapng") as (pid, port), Good(port) as good:
        good.call()
        before, until = memory(pid), time.monotonic() + SECONDS
        context = multiprocessing.get_context("spawn")
        processes = [context.Process(target=each, args=(port, until)) for each in flood]
        for process in processes:
            process.start()
        calls = 0
        while time.monotonic() < until:
            good.call()
            calls += 1
        for process in processes:
            process.join(30)
        wait_until_read(port)
        assert good.call() == 0
        assert memory(pid) - before < MAX_GROWTH
    assert calls > 0
