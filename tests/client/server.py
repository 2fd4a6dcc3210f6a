"""`Peer` on real sockets, in a thread, for programs that are run as a user runs them."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial

from tests.client.peer import Answer, Peer
from tests.memory_link import MemoryLink


class _End(MemoryLink):
    """The server's end of a socket, in the place of a memory link."""

    def __init__(self, datagrams: bool, send: Callable[[bytes], object]) -> None:
        super().__init__(("server", 5007), ("client", 1), lambda _: (), datagrams)
        self._send_to_client = send

    def send(self, data: bytes) -> None:
        self._send_to_client(data)


class UdpServer:
    """Answers clients over UDP.

    Attributes:
        port: where it listens on 127.0.0.1.
        peers: of each client, in the order in which they came.
        prepare: is called with each new peer.
    """

    def __init__(self, sock: socket.socket, prepare: Callable[[Peer], None]) -> None:
        self.port: int = sock.getsockname()[1]
        self.peers: dict[object, Peer] = {}
        self._sock = sock
        self._prepare = prepare

    def serve(self) -> None:
        """Answer until an empty packet comes."""
        while True:
            data, address = self._sock.recvfrom(2048)
            if not data:
                return
            if address not in self.peers:
                self.peers[address] = Peer(_End(True, partial(self._send, address)))
                self._prepare(self.peers[address])
            self.peers[address].on_data(data)

    def _send(self, address: tuple[str, int], raw: bytes) -> None:
        self._sock.sendto(raw, address)


@contextmanager
def udp_server(prepare: Callable[[Peer], None] = lambda peer: None) -> Iterator[UdpServer]:
    """Run a server for the length of a block."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        server = UdpServer(sock, prepare)
        thread = threading.Thread(target=server.serve)
        thread.start()
        try:
            yield server
        finally:
            sock.sendto(b"", sock.getsockname())
            thread.join()


def answering(**answers: Answer | None) -> AbstractContextManager[UdpServer]:
    """Run a server that answers some functions otherwise, or with None not at all."""
    return udp_server(lambda peer: peer.answers.update(answers))


@contextmanager
def breaking_server(function: str, times: int) -> Iterator[int]:
    """Run a server for one TCP client, which hangs up once a function was called so often; yield its port."""

    def serve() -> None:
        with listener.accept()[0] as sock:
            peer = Peer(_End(False, sock.sendall))
            while peer.functions.count(function) < times and (data := sock.recv(2048)):
                peer.on_data(data)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(20)
        thread = threading.Thread(target=serve)
        thread.start()
        yield listener.getsockname()[1]
        thread.join()
