"""The process in which the scripts run: it takes orders from the proxy, calls the hooks and answers."""

from __future__ import annotations

import ctypes
import faulthandler
import gc
import os
import signal
import socket
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from bcapscope.faults.message import Message
from bcapscope.proxy.addons import Addons, Client, load_addons
from bcapscope.proxy.scriptwire import (
    LONGEST_SENTENCE,
    MOST_SENTENCES,
    Answer,
    Connected,
    Expire,
    Finish,
    Gone,
    Loaded,
    Order,
    Passing,
    ScriptError,
    Statement,
    Unpacker,
    Unusable,
    pack,
)
from bcapscope.traffic.observation import Conversation, Direction, Endpoint, Flow, Transport
from bcapscope.traffic.question import Questions

_PR_SET_PDEATHSIG = 1
_READ = 1 << 16


class ScriptHost:
    """Does what the orders say, without sockets or clocks of its own."""

    def __init__(self, addons: Addons) -> None:
        """Take the addons; `tell` of them is taken over."""
        self._addons = addons
        self._clients: dict[int, tuple[Client, Conversation]] = {}
        self._questions = Questions()
        self._messages = 0
        self._said: list[str] = []
        addons.tell = self._said.append

    def obey(self, order: Order) -> Answer:
        """Do what an order says.

        Raises:
            KeyError: the order is about a client that is not known.
        """
        match order:
            case Passing():
                return self._show(order)
            case Connected():
                self._meet(order)
            case Gone():
                client, conversation = self._clients.pop(order.client)
                self._questions.forget(conversation)
                self._addons.gone(client, conversation)
            case Expire():
                self._addons.expire(order.time)
            case Finish():
                self._addons.done()
        return self._answer()

    def _meet(self, order: Connected) -> None:
        end, controller = (Endpoint(*each) for each in order.ends)
        transport = Transport(order.transport)
        client = Client(order.client, end, controller, transport)
        self._clients[order.client] = client, Conversation(end, controller, transport, "the proxy")
        self._addons.connected(client)

    def _show(self, order: Passing) -> Answer:
        client, conversation = self._clients[order.client]
        self._messages += 1
        direction = Direction.REQUEST if order.up else Direction.RESPONSE
        message = Message(self._messages, Flow(conversation, direction), order.data, order.now, order.time)
        message.ask(self._questions)
        passing = self._addons.see(client, message)
        changed = None if passing.data == order.data else bytes(passing.data)
        results = tuple(map(int, passing.answers))
        return self._answer(data=changed, dropped=bool(passing.dropped), results=results)

    def _answer(self, **verdict: Any) -> Answer:
        said = tuple(text[:LONGEST_SENTENCE] for text in self._said[:MOST_SENTENCES])
        self._said.clear()
        return Answer(said, self._addons.errors, self._addons.waits, **verdict)


def main(
    descriptor: int | None, traces: int | None, parent: int, paths: Sequence[str], megabytes: int
) -> None:
    """Run scripts until the proxy ends; the entry of the process.

    Args:
        descriptor: of the socket to the proxy; None where standard input says how to make one.
        traces: a file descriptor to which the place in the scripts is written on SIGUSR1; None for none.
        parent: number of the proxy's process.
        paths: of the scripts.
        megabytes: that the process may allocate.
    """
    proxy = _shared() if descriptor is None else socket.socket(fileno=descriptor)
    try:
        _isolate(traces, parent, megabytes)
        _run(proxy, paths)
    except (OSError, MemoryError):  # a script has closed the socket, or taken all memory: the proxy says that
        proxy.detach()
        sys.exit(1)


def _run(proxy: socket.socket, paths: Sequence[str]) -> None:
    try:
        addons = Addons([addon for path in paths for addon in load_addons(path)])
    except ScriptError as error:
        _say(proxy, Unusable(str(error)[:LONGEST_SENTENCE]))
        return
    _say(proxy, Loaded(addons.hooks))
    gc.collect()
    gc.freeze()  # what was loaded stays: looking through it for garbage would hold messages up
    _serve(proxy, ScriptHost(addons))


def _serve(proxy: socket.socket, host: ScriptHost) -> None:
    """Carry out orders until the proxy closes the connection."""
    orders: Unpacker[Order] = Unpacker(Order)
    while data := proxy.recv(_READ):
        orders.add(data)
        while (order := orders.next()) is not None:
            _say(proxy, host.obey(order))


def _say(proxy: socket.socket, statement: Statement) -> None:
    proxy.sendall(pack(statement))


def _isolate(traces: int | None, parent: int, megabytes: int) -> None:
    """Make sure that the process ends with the proxy, keeps its memory limit, and can report where it is."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it ended before it could have been noticed
            sys.exit()
    _limit_memory(megabytes << 20)
    if traces is not None:
        faulthandler.enable(traces, all_threads=False)
        faulthandler.register(signal.SIGUSR1, traces, all_threads=False)
    # What was printed is not lost if the process is killed.
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # nobody has replaced it yet


def _limit_memory(size: int) -> None:
    """Let allocating more fail; where the system has no such limit, there is none."""
    if sys.platform == "win32":
        return
    import resource  # noqa: PLC0415 - there is none on Windows

    # RLIMIT_DATA counts what can be written to, on Linux; RLIMIT_AS also what is only reserved.
    kind = resource.RLIMIT_DATA if sys.platform == "linux" else resource.RLIMIT_AS
    with suppress(ValueError, OSError):
        resource.setrlimit(kind, (size, size))


def _shared() -> socket.socket:
    """Take over the socket that the proxy shares, on Windows."""
    return socket.fromshare(sys.stdin.buffer.read())  # type: ignore[attr-defined,no-any-return]  # there only
