"""Waiting for sockets in either way."""

from __future__ import annotations

import os
import select
import socket
import time

import pytest

from bcapscope.proxy.poller import READ, WRITE, Poller, SelectPoller, make_poller, open_ticker, wait_precisely


@pytest.mark.parametrize("make", [make_poller, SelectPoller])
def test_what_happens_is_told(make: type[SelectPoller]) -> None:
    poller: Poller = make()
    one, other = socket.socketpair()
    with one, other:
        poller.register(one.fileno(), READ)
        assert poller.poll(0) == []
        other.send(b"x")
        assert poller.poll(1) == [(one.fileno(), READ)]
        poller.modify(one.fileno(), READ | WRITE)
        assert poller.poll(1) == [(one.fileno(), READ | WRITE)]
        assert wait_precisely(poller, 1) == [(one.fileno(), READ | WRITE)]
        poller.modify(one.fileno(), WRITE)
        assert poller.poll(1) == [(one.fileno(), WRITE)]
        poller.modify(one.fileno(), 0)
        assert poller.poll(0) == []
        poller.unregister(one.fileno())
        began = time.monotonic()
        assert wait_precisely(poller, 0.05) == []
        assert time.monotonic() - began >= 0.05
    poller.close()


def test_a_ticker_ticks_and_does_not_wait() -> None:
    began = time.monotonic()
    ticker, slow = open_ticker(0.02), open_ticker(600)
    if ticker is None or slow is None:
        pytest.skip("there is no such thing here")
    for _ in range(3):
        assert select.select([ticker], (), (), 10)[0]
        os.read(ticker, 8)
    assert time.monotonic() - began > 0.05
    with pytest.raises(BlockingIOError):
        os.read(slow, 8)
    os.close(ticker)
    os.close(slow)
