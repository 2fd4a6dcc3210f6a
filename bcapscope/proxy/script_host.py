"""The process in which the scripts run. This process receives orders from the proxy, calls the hooks of the
scripts and answers the proxy."""

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

from bcapscope.faults.wire_message import WireMessage
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.proxy.addons import AddonClient, AddonRunner, load_addons
from bcapscope.proxy.script_protocol import (
    MAX_SENTENCES,
    ClientConnected,
    ClientGone,
    ExpireCalls,
    FinishScripts,
    FrameUnpacker,
    MessageShown,
    ScriptAnswer,
    ScriptError,
    ScriptOrder,
    ScriptsLoaded,
    ScriptStatement,
    ScriptsUnusable,
    pack,
    wire_sentence,
)
from bcapscope.traffic.call_kind import RecentRequests
from bcapscope.traffic.observation import (
    SERVER_PARTICIPANT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Transport,
)

_PR_SET_PDEATHSIG = 1
_READ = 1 << 16


class ScriptHost:
    """Handles each `ScriptOrder` that the proxy sends to the scripts. This class uses no socket and no
    clock.
    """

    def __init__(self, addons: AddonRunner) -> None:
        """Run `addons`, and collect their messages for the user."""
        self._addons = addons
        self._clients: dict[int, tuple[AddonClient, Conversation]] = {}
        self._recent_requests = RecentRequests()
        self._templates = FrameTemplates()
        self._messages = 0
        self._notices: list[Message] = []
        addons.notify = self._notices.append

    def execute(self, order: ScriptOrder) -> ScriptAnswer:
        """Handle a `ScriptOrder` of the proxy, and return the answer of the scripts.

        Raises:
            KeyError: The order refers to an unknown client.
        """
        match order:
            case MessageShown():
                return self._show_message(order)
            case ClientConnected():
                self._add_client(order)
            case ClientGone():
                client, conversation = self._clients.pop(order.client)
                self._recent_requests.close_conversation(conversation)
                self._addons.client_gone(client, conversation)
            case ExpireCalls():
                self._addons.expire_calls(order.time)
            case FinishScripts():
                self._addons.proxy_ended()
        return self._answer()

    def _add_client(self, order: ClientConnected) -> None:
        end, controller = (Endpoint(*each) for each in order.ends)
        transport = Transport(order.transport)
        client = AddonClient(order.client, end, controller, transport)
        self._clients[order.client] = client, Conversation(end, controller, transport, SERVER_PARTICIPANT)
        self._addons.client_connected(client)

    def _show_message(self, order: MessageShown) -> ScriptAnswer:
        client, conversation = self._clients[order.client]
        self._messages += 1
        direction = Direction.REQUEST if order.up else Direction.RESPONSE
        message = WireMessage(
            self._messages,
            Flow(conversation, direction),
            order.data,
            order.now,
            order.time,
            templates=self._templates,
        )
        message.annotate(self._recent_requests)
        passing = self._addons.run_message_hooks(client, message)
        changed = None if passing.data == order.data else bytes(passing.data)
        results = tuple(map(int, passing.answers))
        return self._answer(data=changed, dropped=bool(passing.dropped), results=results)

    def _answer(self, **verdict: Any) -> ScriptAnswer:
        notices = tuple(map(wire_sentence, self._notices[:MAX_SENTENCES]))
        self._notices.clear()
        return ScriptAnswer(notices, self._addons.errors, self._addons.has_open_calls, **verdict)


def main(
    descriptor: int | None, traces: int | None, parent: int, paths: Sequence[str], megabytes: int
) -> None:
    """Run scripts until the proxy ends. This is the entry point of the process.

    Args:
        descriptor: File descriptor of the socket to the proxy; None to read a description of the socket from
            standard input.
        traces: File descriptor for reports. On SIGUSR1, the process writes the script line that it executes
            to `traces`. None if the system has no such signal.
        parent: Process id of the proxy.
        megabytes: Maximum memory that the process may allocate, in megabytes.
    """
    proxy = _shared_socket() if descriptor is None else socket.socket(fileno=descriptor)
    try:
        _isolate(traces, parent, megabytes)
        _run(proxy, paths)
    # a script closed the socket or used up the memory; the proxy reports the end of the process
    except (OSError, MemoryError):
        proxy.detach()
        sys.exit(1)


def _run(proxy: socket.socket, paths: Sequence[str]) -> None:
    try:
        addons = AddonRunner([addon for path in paths for addon in load_addons(path)])
    except ScriptError as error:
        _send_statement(proxy, ScriptsUnusable(wire_sentence(error.message)))
        return
    _send_statement(proxy, ScriptsLoaded(addons.hooks))
    gc.collect()
    gc.freeze()  # garbage collection of the loaded objects would delay messages
    _serve(proxy, ScriptHost(addons))


def _serve(proxy: socket.socket, host: ScriptHost) -> None:
    orders: FrameUnpacker[ScriptOrder] = FrameUnpacker(ScriptOrder)
    while data := proxy.recv(_READ):
        orders.feed_bytes(data)
        while (order := orders.next_frame()) is not None:
            _send_statement(proxy, host.execute(order))


def _send_statement(proxy: socket.socket, statement: ScriptStatement) -> None:
    proxy.sendall(pack(statement))


def _isolate(traces: int | None, parent: int, megabytes: int) -> None:
    """Make the process end with the proxy, limit its memory, and let it report its current line in the
    scripts."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # the proxy had already ended before prctl took effect
            sys.exit()
    _limit_memory(megabytes << 20)
    if traces is not None:
        faulthandler.enable(traces, all_threads=False)
        faulthandler.register(signal.SIGUSR1, traces, all_threads=False)
    # Flush each line, so that text printed before a kill is not lost.
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            # No script has replaced the stream yet.
            stream.reconfigure(line_buffering=True)  # type: ignore[union-attr]


def _limit_memory(size: int) -> None:
    """Limit the memory that this process can allocate, if the operating system supports a limit."""
    if sys.platform == "win32":
        return
    import resource  # noqa: PLC0415 - Windows has no such module

    # On Linux, RLIMIT_DATA counts writable memory; RLIMIT_AS also counts memory that is only reserved.
    kind = resource.RLIMIT_DATA if sys.platform == "linux" else resource.RLIMIT_AS
    with suppress(ValueError, OSError):
        resource.setrlimit(kind, (size, size))


def _shared_socket() -> socket.socket:
    return socket.fromshare(sys.stdin.buffer.read())  # type: ignore[attr-defined,no-any-return]  # there only
