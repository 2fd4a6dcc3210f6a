"""The least that Python can do about a request: send it back. One transport, no waiting but for the next.

Run as ``python -m tests.bench.echo udp|tcp``; prints its port.
"""

from __future__ import annotations

import socket
import sys


def over_udp() -> None:
    """Send every datagram back."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        print(sock.getsockname()[1], flush=True)
        while True:
            data, address = sock.recvfrom(65535)
            sock.sendto(data, address)


def over_tcp() -> None:
    """Send what one client sends back to it."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        print(listener.getsockname()[1], flush=True)
        client, _ = listener.accept()
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while data := client.recv(65535):
            client.send(data)


if __name__ == "__main__":
    {"udp": over_udp, "tcp": over_tcp}[sys.argv[1]]()
