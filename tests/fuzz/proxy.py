"""Nonsense through a proxy, from either side: it arrives as it was sent, and nothing dies or leaks.

Run from the project's root as ``python -m tests.fuzz.proxy SECONDS [SEED]``.
"""

from __future__ import annotations

import random
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from tests.bench.proxy import private_memory
from tests.cli.proxying import PATIENCE, Process, proxy
from tests.proxy.relaying import datagrams, listening, port_of
from tests.proxy.test_tcp_session import cut, receive

_SOUND = [
    encode_frame(7, 0, 1, (Variant(VT.BSTR, ",WDT=400"),)),
    encode_frame(8, 7, 64, (Variant(VT.I4, 1), Variant(VT.BSTR, "slvMove"), Variant(VT.R8, 0.5))),
    encode_frame(8, 0, 0, (Variant(VT.I4, 1),)),
    encode_frame(9, 0, 0x80004005),
]

_OPENING = _SOUND[0]


def nonsense(chance: random.Random, most: int) -> bytes:
    """Make a frame that is damaged, several, a part of one, or anything."""
    data = bytearray(b"".join(chance.choices(_SOUND, k=chance.randrange(1, 4))))
    kind = chance.randrange(6)
    if kind == 0:
        return chance.randbytes(chance.randrange(most))
    if kind == 1:
        return bytes(data[: chance.randrange(len(data) + 1)])
    for _ in range(chance.randrange(8)):
        data[chance.randrange(len(data))] = chance.randrange(256)
    if kind == 2:
        data += chance.randbytes(chance.randrange(40))
    return bytes(data)


class Fuzz:
    """Both ends of a proxy.

    Attributes:
        datagrams: that arrived as they were sent.
        streams: likewise.
    """

    def __init__(self, port: int, server: socket.socket, door: socket.socket, chance: random.Random) -> None:
        self.datagrams = self.streams = 0
        self._address = ("127.0.0.1", port)
        self._server = server
        self._door = door
        self._chance = chance

    def exchange_datagrams(self) -> None:
        """Send some, both ways, as a new client."""
        with datagrams() as client:
            client.connect(self._address)
            for _ in range(self._chance.randrange(1, 60)):
                self.datagrams += 2
                data = nonsense(self._chance, 60_000 if self._chance.random() < 0.01 else 700)
                client.send(data)
                heard, way = self._server.recvfrom(65536)
                assert heard == data
                data = nonsense(self._chance, 700)
                self._server.sendto(data, way)
                assert client.recv(65536) == data

    def exchange_streams(self) -> None:
        """Make a connection, send both ways, and end it in one of the ways that there are."""
        with socket.create_connection(self._address, 30) as client:
            client.sendall(_OPENING)  # a client that has sent no frame does not reach the controller
            server, _ = self._door.accept()
            with server:
                server.settimeout(30)
                assert receive(server, len(_OPENING)) == _OPENING
                for _ in range(self._chance.randrange(20)):
                    self.streams += 1
                    data = nonsense(self._chance, 20_000)
                    source, target = self._chance.sample((client, server), 2)
                    source.sendall(data)
                    assert receive(target, len(data)) == data
                end = self._chance.randrange(4)
                if end == 0:
                    cut(self._chance.choice((client, server)))
                elif end == 1:
                    client.shutdown(socket.SHUT_WR)
                    assert server.recv(1) == b""


@contextmanager
def between(folder: Path, chance: random.Random) -> Iterator[tuple[Process, Fuzz]]:
    """Run a proxy that records between two ends."""
    with ExitStack() as stack:
        door = stack.enter_context(listening())
        server = stack.enter_context(datagrams(port_of(door)))
        words = ("--record", str(folder / "f.pcapng"), "--ring", "3x20MB", "--forget", "1")
        process = stack.enter_context(proxy(port_of(door), *words))
        yield process, Fuzz(process.port, server, door, chance)


def state(process: Process) -> str:
    """Tell how many files are open and how much memory is in use."""
    pid = process.popen.pid
    children = map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split())
    files = len(list(Path(f"/proc/{pid}/fd").iterdir()))
    return f"{files} files open; {private_memory([pid, *children])}"


def end(process: Process) -> str:
    """Interrupt the proxy; return what it wrote.

    On a busy machine the recording may have holes. The proxy then says so and exits with 6.
    """
    process.popen.send_signal(signal.SIGINT)
    code = process.popen.wait(PATIENCE)
    process.close()
    wanted = ExitCode.UNWRITABLE if "forwarded but neither shown nor recorded" in process.err else ExitCode.OK
    assert code == wanted, process.err[-3000:]
    return process.err


def main() -> None:
    """Fuzz for so many seconds."""
    seconds = float(sys.argv[1])
    chance = random.Random(int(sys.argv[2]) if len(sys.argv) > 2 else 1)
    with tempfile.TemporaryDirectory() as folder, between(Path(folder), chance) as (process, fuzz):
        start = shown = time.monotonic()
        while (now := time.monotonic()) - start < seconds:
            fuzz.exchange_datagrams()
            fuzz.exchange_streams()
            if now - shown > 30:
                shown = now
                print(
                    f"{now - start:5.0f} s {fuzz.datagrams} datagrams {fuzz.streams} pieces {state(process)}"
                )
                sys.stdout.flush()
        time.sleep(3)
        print(f"at the end {fuzz.datagrams} datagrams {fuzz.streams} pieces {state(process)}")
        print(end(process)[-3000:])


if __name__ == "__main__":
    main()
