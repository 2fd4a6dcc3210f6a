"""The process of the relay and the process that watches it."""

from __future__ import annotations

import socket
import threading
from contextlib import closing

from bcapscope.cli.proxyrun import Proxy
from bcapscope.cli.proxywishes import Look, Wishes


def test_who_hears_of_an_answer_that_is_taken_already_does_not_wait_for_another() -> None:
    here, there = socket.socketpair()
    with here, there, closing(Proxy(Wishes(None, None, Look(None), "never"), here)) as proxy:
        proxy._other_end.send_bytes(b"[]")
        hearing = threading.Thread(target=lambda: list(map(Proxy._hear, [proxy] * 2)), daemon=True)
        hearing.start()
        hearing.join(5)
        heard = not hearing.is_alive()
        proxy._other_end.close()  # would also wake who waits
        hearing.join(5)
    assert heard
