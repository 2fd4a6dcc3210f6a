"""Runs a proxy: the relay in this process, and the watcher in a separate process."""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
import stat
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from typing import TYPE_CHECKING

import msgspec

from bcapscope.errors import FileWriteError
from bcapscope.live.cpu_wakefulness import CpuWakefulness, datagrams_passed
from bcapscope.live.end_signals import end_signals_blocked
from bcapscope.live.proxy_options import (
    BEGIN,
    CLOSE_SESSIONS,
    INCOMPLETE,
    READY,
    ClosingRequests,
    ProxyOptions,
    run_watcher,
)
from bcapscope.live.standard_streams import print_stderr
from bcapscope.live.terminal_writer import ERASE_LINE
from bcapscope.live.watcher_priority import WatcherPriority, idle_priority_switch
from bcapscope.messages import Message, MessageFormatter
from bcapscope.messages.message_codec import decode_message, encode_message
from bcapscope.messages.os_errors import os_reason
from bcapscope.messages.places import joined_clauses
from bcapscope.player.realtime import realtime_priority
from bcapscope.proxy.listener_spec import ListenerSpec
from bcapscope.proxy.listeners import open_listeners
from bcapscope.proxy.relay import Relay
from bcapscope.proxy.ring_buffer import RING_OVERHEAD, RingWriter
from bcapscope.proxy.tcp_listener import TcpListener
from bcapscope.proxy.udp_listener import UdpListener, UdpSession
from bcapscope.render.escape import printable
from bcapscope.traffic.observation import Endpoint
from bcapscope.transport.descriptors import raise_descriptor_limit

if TYPE_CHECKING:
    from bcapscope.proxy.rule_policy import RulePolicy

RING_SIZE = 32 << 20
"""Size of the ring in bytes: about 20 s of traffic of four robots with one set point per ms each."""

_MAX_DESCRIPTORS = 1024
"""Requested limit of open file descriptors. A TCP client needs two descriptors. A UDP client needs one."""

_POLL_INTERVAL = 0.05
_BEGINS_WITHIN = 30.0
_ANSWERS_WITHIN = 3.0
_ENDS_WITHIN = 60.0

_SESSIONS_CLOSE_WITHIN = 3.0
"""Maximum time in seconds for closing sessions, because an unreachable controller does not reply."""

_TOTALS_WITHIN = 0.5
"""Maximum time in seconds for printing the totals at the end."""

_STDIN = 0
_HANGUP = getattr(signal, "SIGHUP", None)

_SILENT_FOR_NS = 30_000_000_000
"""After the terminal was closed, a client that is silent for this time in ns counts as gone."""


class ProxySupervisor:
    """Runs the relay, and starts and ends the watcher process. `relay` may be used before `run`."""

    def __init__(
        self,
        options: ProxyOptions,
        end_signals: socket.socket,
        policy: RulePolicy | None = None,
        *,
        low_latency: bool = False,
    ) -> None:
        """Create a relay without listeners. `end_signals` is the socket of `end_signal_socket`. Raises
        FileWriteError if the shared memory or the relay cannot be created.
        """
        self._options = options
        self._words = MessageFormatter(options.view.language)
        self._end_signals = end_signals
        raise_descriptor_limit(_MAX_DESCRIPTORS)
        self._memory = _shared_memory(RING_OVERHEAD + RING_SIZE)
        self._is_memory_linked = True
        assert self._memory.buf is not None
        self._ring = RingWriter(self._memory.buf[: RING_OVERHEAD + RING_SIZE])
        self._context = multiprocessing.get_context("spawn")
        try:
            self.relay = Relay(self._ring, policy)
            self._watcher_pipe, self._watcher_end = self._context.Pipe()
        except OSError as error:
            self._release_memory()
            raise FileWriteError(Message("proxy.part.relay"), os_reason(error)) from None
        self._watcher: multiprocessing.process.BaseProcess | None = None
        self._is_watched = self._has_watcher_begun = False
        self.is_recording_incomplete = False
        self._watcher_priority: WatcherPriority | None = None
        self._wakefulness = CpuWakefulness() if low_latency else None
        self._ports: list[TcpListener | UdpListener] = []
        self._ending_since = 0.0
        self._is_terminal_closed = self._must_end_now = False
        self._closing_requests: list[ClosingRequests] = []

    def listen(self, listener: ListenerSpec, forget_after: int) -> Endpoint:
        """Listen for clients. The relay removes a UDP client that was silent for `forget_after` ns.

        Raises ProxyListenError, or UnreachableError if the controller's name cannot be resolved.
        """
        address, ports = open_listeners(self.relay, listener, forget_after)
        self._ports += ports
        return address

    def start_watcher(self, wait_for_scripts: Callable[[float], bool] | None = None) -> None:
        """Start the watcher process and wait until it is ready.

        `wait_for_scripts(seconds)` waits at most `seconds` for the scripts to start, and returns whether the
        scripts have started. The watcher loads while the scripts start, which saves 20 to 30 ms. The watcher
        records only after all scripts have started.

        Raises FileWriteError if the recording or the watcher process fails, and KeyboardInterrupt after a
        signal.
        """
        arguments = self._memory.name, self._watcher_end, self._options
        watcher = self._context.Process(target=run_watcher, args=arguments, name="watch")
        try:
            with end_signals_blocked():
                watcher.start()
        except OSError as error:
            raise FileWriteError(Message("proxy.part.watcher"), os_reason(error)) from None
        self._watcher = watcher
        self._watcher_end.close()
        if wait_for_scripts is not None:
            self._wait_for(wait_for_scripts)
        self._send_to_watcher(BEGIN)
        until = time.monotonic() + _BEGINS_WITHIN
        self._wait_for(lambda seconds: self._watcher_pipe.poll(seconds) or time.monotonic() > until)
        answer = encode_message(Message("os.no-answer"))
        try:
            if self._watcher_pipe.poll():
                answer = self._watcher_pipe.recv_bytes()
        except (EOFError, OSError):
            answer = encode_message(Message("proxy.writer-ended"))
        if answer != READY:
            path = self._options.record or Message("proxy.part.recording")
            raise FileWriteError(path, decode_message(answer))
        self._is_watched = self._has_watcher_begun = True
        self._unlink_memory()
        if sys.platform != "win32":  # Windows cannot wait for a pipe and sockets together
            self.relay.watch(self._watcher_pipe.fileno(), lambda _: self._receive_from_watcher())

    def end_with_parent(self) -> None:
        """If standard input ends, act as if the terminal was closed, because the parent program has ended."""
        if sys.platform == "win32":  # Windows cannot wait for a pipe and sockets together
            return
        if sys.stdin is None or not _has_other_end(_STDIN):
            self._is_terminal_closed = True
        else:
            self.relay.watch(_STDIN, self._on_parent_input)

    def run(self, on_ready: Callable[[], None]) -> None:
        """Accept clients, call `on_ready`, and forward traffic until the proxy must end. Then shut down.
        Raises KeyboardInterrupt if a signal arrived before the proxy started.
        """
        self._raise_if_ended()
        self.relay.watch(self._end_signals.fileno(), self._on_signal)
        # Measured while other programs were busy: without real-time priority, one round trip in ten took 4 ms
        # longer. With real-time priority, Linux keeps the relay on the processor that the relay used before.
        # The processor that runs the relay should therefore not sleep.
        with realtime_priority() as grade:
            if not grade.realtime:
                self._send_to_watcher(encode_message(grade.text))
            # Call `idle_priority_switch` after `realtime_priority`, because `idle_priority_switch` starts a
            # thread. `realtime_priority` locks the stack of every existing thread into memory.
            if self._is_watched:
                assert self._watcher is not None
                assert self._watcher.pid is not None
                self._watcher_priority = WatcherPriority(self._ring, idle_priority_switch(self._watcher.pid))
            ports, self._ports = self._ports, []
            self.relay.listen(ports)
            on_ready()
            self.relay.run(self._do_periodic_work)
            self.relay.close_listeners()
            self.relay.release_all_held()
            self._close_udp_sessions()
            self.relay.close()
            if self.relay.policy is not None:
                self.relay.policy.close(time.monotonic_ns())
                for line in self.relay.policy.report():
                    self.relay.notify(line)
            if not self._is_watched:
                self._print_totals()

    def _print_totals(self) -> None:
        from bcapscope.live.relay_figures import losses, totals  # imports NumPy

        report = () if self.relay.policy is None else self.relay.policy.report()
        lines = *report, joined_clauses(totals(self._ring.counts)), *losses(self._ring.counts)
        texts = (self._words.text(line) for line in lines if line is not None)
        _print_aside("\n".join(texts)).join(_TOTALS_WITHIN)

    def close(self) -> None:
        """Wait until the watcher has printed its summary or a signal arrives, then release all resources."""
        if self._wakefulness is not None:
            self._wakefulness.allow_deep_sleep()
        for port in self._ports:  # `run` was not called, so the relay does not own the listeners
            port.close()
            port.release()
        self._ports.clear()
        self.relay.close()
        self._watcher_pipe.close()
        if self._watcher_priority is not None:
            self._watcher_priority.raise_for_good()
        if self._watcher is not None:
            if not self._is_watched:  # the watcher has not started, or has ended
                self._watcher.kill()
            until = time.monotonic() + _ENDS_WITHIN
            while self._watcher.is_alive() and time.monotonic() < until and not self.must_end_now():
                self._watcher.join(_POLL_INTERVAL)
            if self._watcher.is_alive():
                print_stderr(self._words("watcher.slow-end"))
                self._watcher.kill()
                self._watcher.join(_ENDS_WITHIN)
            if self._has_watcher_begun:
                self._check_recording(self._watcher.exitcode)
            self._watcher = None
        self._release_memory()

    def _check_recording(self, code: int | None) -> None:
        self.is_recording_incomplete = self._options.record is not None and code != 0
        # Before the watcher exits with `INCOMPLETE`, the watcher reports the incomplete recording.
        if self.is_recording_incomplete and code != INCOMPLETE:
            name = printable(str(self._options.record))
            print_stderr(self._words("recording.incomplete", name=name))

    def _release_memory(self) -> None:
        self._ring.release()
        self._memory.close()
        self._unlink_memory()

    def _unlink_memory(self) -> None:
        """Remove the name of the shared memory. The memory is freed when all its users have ended."""
        if self._is_memory_linked:
            self._is_memory_linked = False
            self._memory.unlink()

    def _wait_for(self, is_ready: Callable[[float], bool]) -> None:
        """Repeat `is_ready(seconds)` until `is_ready` returns True; each call waits at most `seconds`. Raise
        `KeyboardInterrupt` if a signal arrives before `is_ready` returns True.
        """
        while not is_ready(_POLL_INTERVAL):
            self._raise_if_ended()

    def _raise_if_ended(self) -> None:
        # Read only the first signal, because `must_end_now` reads the signals after it.
        if self._read_signals(1):
            raise KeyboardInterrupt

    def must_end_now(self) -> bool:
        """Return whether a signal other than SIGHUP arrived during the shutdown."""
        if any(number != _HANGUP for number in self._read_signals()):
            self._must_end_now = True
        return self._must_end_now

    def _read_signals(self, most: int = 16) -> bytes:
        with suppress(BlockingIOError):
            return self._end_signals.recv(most)
        return b""

    def _on_signal(self, _: int) -> None:
        """Shut down after a signal. After SIGHUP, run without the terminal until all clients are silent."""
        for number in self._read_signals():
            if number == _HANGUP:
                self._is_terminal_closed = True
            else:
                self._begin_ending()

    def _begin_ending(self) -> None:
        """Shut down gracefully at the first signal, and immediately at the second."""
        if self._watcher_priority is not None:
            self._watcher_priority.raise_for_good()
        if self._ending_since or not self._send_to_watcher(CLOSE_SESSIONS):
            self.relay.stop()
        self._ending_since = time.monotonic()

    def _on_parent_input(self, _: int) -> None:
        if not os.read(_STDIN, 1024):
            self.relay.unwatch(_STDIN)
            self._is_terminal_closed = True

    def _do_periodic_work(self) -> None:
        if self._wakefulness is not None:
            self._wakefulness.update(datagrams_passed(self._ring.counts), time.monotonic())
        if self._is_watched and self._watcher_priority is not None:
            self._watcher_priority.update(time.monotonic())
        if self._ending_since and time.monotonic() - self._ending_since > _ANSWERS_WITHIN:
            self.relay.stop()
        if self._is_watched:
            self._receive_from_watcher()
        if self._is_terminal_closed and not self._ending_since:
            now = self.relay.now
            if all(now - session.last_heard > _SILENT_FOR_NS for session in self.relay.sessions.values()):
                self._begin_ending()

    def _receive_from_watcher(self) -> None:
        """Read the closing requests from the watcher if these requests have arrived. A closed pipe means that
        the watcher has ended.

        Do not wait for a message: an earlier call may have read the closing requests. The relay would then
        wait for the watcher, while the watcher waits for the relay to end.
        """
        try:
            if not self._watcher_pipe.poll():
                return
            answer = self._watcher_pipe.recv_bytes()
            self._closing_requests = msgspec.json.decode(answer, type=list[ClosingRequests])
            self.relay.stop()
        except (EOFError, OSError):
            self._is_watched = False
            self.relay.unwatch(self._watcher_pipe.fileno())
            self._ring.detach_reader()
            _print_aside(self._words("watcher.ended"))
            if self._ending_since:
                self.relay.stop()

    def _send_to_watcher(self, message: bytes) -> bool:
        try:
            self._watcher_pipe.send_bytes(message)
        except OSError:
            return False
        return self._is_watched

    def _close_udp_sessions(self) -> None:
        """Close the sessions that UDP clients left open, first those in which a robot may still move."""
        until = time.monotonic() + _SESSIONS_CLOSE_WITHIN
        for closing in sorted(self._closing_requests, key=lambda each: not each.open_state):
            session = self.relay.sessions.get(closing.client)
            if not isinstance(session, UdpSession):
                continue
            if self.must_end_now():
                until = 0.0
            client, controller = session.conversation.client, session.conversation.server
            answered = session.send_closing_requests(closing.requests, until)
            session_name = Message("session.closed.plain", client=str(client), controller=str(controller))
            if closing.open_state:
                state = decode_message(closing.open_state)
                session_name = Message("session.closed.state", session=session_name, state=state)
            if answered == len(closing.requests):
                self.relay.notify(Message("session.ended", session=session_name))
            else:
                reason = Message("os.no-answer" if time.monotonic() < until else "session.no-time")
                self.relay.notify(Message("session.not-ended", session=session_name, reason=reason))


def _has_other_end(descriptor: int) -> bool:
    """Return whether the descriptor is of a kind that reports when the other end was closed."""
    mode = os.fstat(descriptor).st_mode
    return stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode) or os.isatty(descriptor)


def _print_aside(text: str) -> threading.Thread:
    """Print to standard error in a new thread, and return this thread. If the user stops the terminal
    (Ctrl-S), the new thread waits, and the calling thread continues.

    The new thread writes to the file descriptor, not to `sys.stderr`. A thread that waits in a write to
    `sys.stderr` holds a lock, and the program could not end.
    """

    def write() -> None:
        with suppress(OSError):
            os.write(2, f"{ERASE_LINE if os.isatty(2) else ''}{text}\n".encode("utf-8", "replace"))

    aside = threading.Thread(target=write, name="aside", daemon=True)
    aside.start()
    return aside


def _shared_memory(size: int) -> SharedMemory:
    """Allocate all pages now, because a process is killed if a page cannot be allocated later."""
    try:
        if sys.platform != "win32":
            # If the proxy is killed, Python's resource tracker frees the memory.
            resource_tracker.ensure_running()
        memory = SharedMemory(create=True, size=size)
        try:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(memory._fd, 0, size)  # type: ignore[attr-defined]  # has no public name
        except OSError:
            memory.close()
            memory.unlink()
            raise
    except OSError as error:
        raise FileWriteError(Message("proxy.part.memory"), os_reason(error)) from None
    assert memory.buf is not None
    memory.buf[:] = bytes(len(memory.buf))
    return memory
