"""A proxy at work: the relay here, what watches it in a process of its own."""

from __future__ import annotations

import json
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
from pathlib import Path

from bcapscope.errors import FileWriteError
from bcapscope.live.cpu_wakefulness import CpuLatencyLimit, CpuWakefulness, datagrams_passed
from bcapscope.live.end_signals import end_signals_blocked
from bcapscope.live.proxy_options import BEGIN, CLOSE_SESSIONS, INCOMPLETE, READY, ProxyOptions, run_watcher
from bcapscope.live.standard_streams import print_stderr
from bcapscope.live.terminal_writer import ERASE_LINE
from bcapscope.live.watcher_priority import WatcherPriority, idle_priority_switch
from bcapscope.player.realtime import realtime_priority
from bcapscope.proxy.listener_spec import ListenerSpec
from bcapscope.proxy.listeners import open_listeners
from bcapscope.proxy.policy import Policy
from bcapscope.proxy.relay import Relay
from bcapscope.proxy.ring_buffer import HEADER_SIZE, RingWriter
from bcapscope.proxy.sockets import os_error_text
from bcapscope.proxy.tcp_listener import TcpListener
from bcapscope.proxy.udp_listener import UdpListener, UdpSession
from bcapscope.render.escape import printable
from bcapscope.traffic.observation import Endpoint
from bcapscope.transport.descriptors import raise_descriptor_limit

RING_SIZE = 32 << 20
"""Bytes: twenty seconds of four robots with a set point each millisecond, if nobody watched at all."""

_MAX_DESCRIPTORS = 1024
"""Files that may be open: two for a TCP client, one for a UDP client and for one that is silent so far."""

_POLL_INTERVAL = 0.05
_BEGINS_WITHIN = 30.0
_ANSWERS_WITHIN = 3.0
_ENDS_WITHIN = 60.0
"""Seconds that the watching process has."""

_SESSIONS_CLOSE_WITHIN = 3.0
"""Seconds for all sessions that are ended in their clients' place: a controller that is gone answers none."""

_TOTALS_WITHIN = 0.5
"""Seconds that a terminal has for what is told at the end."""

_STDIN = 0

_SILENT_FOR_NS = 30_000_000_000
"""ns after which a client is taken to have gone, once the terminal is closed."""


class ProxySupervisor:
    """A relay and what watches it.

    Attributes:
        relay: for callers that attach more to it before it runs.
        is_recording_incomplete: after `close`: a recording was requested, and it is incomplete.
    """

    def __init__(
        self,
        options: ProxyOptions,
        end_signals: socket.socket,
        policy: Policy | None = None,
        *,
        low_latency: bool = False,
    ) -> None:
        """Make a relay that listens nowhere yet.

        Args:
            options: of the watcher.
            end_signals: from which the signals come that end programs; see `end_signal_socket`.
            policy: the rules; None without.
            low_latency: keep the machine's processors out of deep sleep while there is much traffic.

        Raises:
            FileWriteError: there is no room for the memory that it shares with the watcher, or the system
                gives nothing to wait with.
        """
        self._options = options
        self._end_signals = end_signals
        raise_descriptor_limit(_MAX_DESCRIPTORS)
        self._memory = _shared_memory(HEADER_SIZE + RING_SIZE)
        self._is_memory_linked = True
        assert self._memory.buf is not None
        self._ring = RingWriter(self._memory.buf[: HEADER_SIZE + RING_SIZE])
        self._context = multiprocessing.get_context("spawn")
        try:
            self.relay = Relay(self._ring, policy)
            self._watcher_pipe, self._watcher_end = self._context.Pipe()
        except OSError as error:
            self._release_memory()
            raise FileWriteError(Path("the relay"), os_error_text(error)) from None
        self._watcher: multiprocessing.process.BaseProcess | None = None
        self._is_watched = self._has_watcher_begun = False
        self.is_recording_incomplete = False
        self._watcher_priority: WatcherPriority | None = None
        self._wakefulness = CpuWakefulness(CpuLatencyLimit()) if low_latency else None
        self._ports: list[TcpListener | UdpListener] = []
        self._ending_since = 0.0
        self._is_terminal_closed = self._must_end_now = False
        self._closing_requests: list[tuple[int, str, list[str]]] = []

    def listen(self, listener: ListenerSpec, forget_after: int) -> Endpoint:
        """Listen; return where. Clients are taken when it runs.

        Args:
            listener: where, and where to.
            forget_after: ns of silence after which a UDP client is forgotten.

        Raises:
            ProxyListenError: it cannot be listened on.
            UnreachableError: the controller's name is unknown.
        """
        address, ports = open_listeners(self.relay, listener, forget_after)
        self._ports += ports
        return address

    def start_watcher(self, wait_for_scripts: Callable[[float], bool] | None = None) -> None:
        """Start the process that watches, and wait until it does.

        Args:
            wait_for_scripts: waits up to so many seconds for what else has to begin; returns whether it has.
                Nothing is recorded before, but the process is loaded meanwhile.

        Raises:
            FileWriteError: the recording cannot be written, or no process be started.
            KeyboardInterrupt: it is to end already.
        """
        arguments = self._memory.name, self._watcher_end, self._options
        watcher = self._context.Process(target=run_watcher, args=arguments, name="watch")
        try:
            with end_signals_blocked():
                watcher.start()
        except OSError as error:
            raise FileWriteError(Path("the process that watches"), os_error_text(error)) from None
        self._watcher = watcher
        self._watcher_end.close()
        while wait_for_scripts is not None and not wait_for_scripts(_POLL_INTERVAL):
            self._raise_if_ended()
        self._send_to_watcher(BEGIN)
        until = time.monotonic() + _BEGINS_WITHIN
        while not self._watcher_pipe.poll(_POLL_INTERVAL) and time.monotonic() < until:
            self._raise_if_ended()
        try:
            answer = self._watcher_pipe.recv_bytes() if self._watcher_pipe.poll() else b"no answer"
        except (EOFError, OSError):
            answer = b"the process that writes it has ended"
        if answer != READY:
            raise FileWriteError(self._options.record or Path("the recording"), answer.decode())
        self._is_watched = self._has_watcher_begun = True
        self._unlink_memory()
        if sys.platform != "win32":  # there a pipe cannot be waited for together with sockets
            self.relay.watch(self._watcher_pipe.fileno(), lambda _: self._receive_from_watcher())

    def end_with_parent(self) -> None:
        """Do as when the terminal is closed once standard input ends: whoever started the proxy is gone."""
        if sys.platform == "win32":  # there a pipe cannot be waited for together with sockets
            return
        if sys.stdin is None or not _has_other_end(_STDIN):
            self._is_terminal_closed = True
        else:
            self.relay.watch(_STDIN, self._on_parent_input)

    def run(self, on_ready: Callable[[], None]) -> None:
        """Pass bytes on until told to end, then end in order; `start_watcher` came before.

        Args:
            on_ready: called when clients are taken.

        Raises:
            KeyboardInterrupt: it is to end already.
        """
        self._raise_if_ended()
        self.relay.watch(self._end_signals.fileno(), self._on_signal)
        # Beside busy programs one round trip in ten waited 4 ms without the priority. With it, Linux wakes
        # the relay where it ran last, not where its waker runs: that processor had better not sleep.
        with realtime_priority() as grade:
            if not grade.realtime:
                self._send_to_watcher(grade.text.encode())
            # Not earlier: it tries something in a thread, whose stack stays, and would be locked as well.
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
        """Tell what is known here, as who watched it tells nothing any more."""
        from bcapscope.live.relay_figures import loss_lines, totals_text  # the watcher's, and NumPy with it

        report = () if self.relay.policy is None else self.relay.policy.report()
        counts = self._ring.counts
        _print_aside("\n".join((*report, totals_text(counts), *loss_lines(counts)))).join(_TOTALS_WITHIN)

    def close(self) -> None:
        """Wait for the watcher's summary, unless asked once more to end, and let go of everything."""
        if self._wakefulness is not None:
            self._wakefulness.allow_sleep()
        for port in self._ports:  # it gave up before the relay had them
            port.close()
            port.release()
        self._ports.clear()
        self.relay.close()
        self._watcher_pipe.close()
        if self._watcher_priority is not None:
            self._watcher_priority.raise_for_good()
        if self._watcher is not None:
            if not self._is_watched:  # it has not begun, or has ended
                self._watcher.kill()
            until = time.monotonic() + _ENDS_WITHIN
            while self._watcher.is_alive() and time.monotonic() < until and not self.must_end_now():
                self._watcher.join(_POLL_INTERVAL)
            if self._watcher.is_alive():
                print_stderr("watching has not ended in time; the last part of the recording may be missing")
                self._watcher.kill()
                self._watcher.join(_ENDS_WITHIN)
            if self._has_watcher_begun:
                self._check_recording(self._watcher.exitcode)
            self._watcher = None
        self._release_memory()

    def _check_recording(self, code: int | None) -> None:
        """Decide by the exit code of the watcher whether the recording is complete."""
        self.is_recording_incomplete = self._options.record is not None and code != 0
        if self.is_recording_incomplete and code != INCOMPLETE:  # it could not say so itself
            print_stderr(f"{printable(str(self._options.record))} is incomplete: the recorder ended early")

    def _release_memory(self) -> None:
        self._ring.release()
        self._memory.close()
        self._unlink_memory()

    def _unlink_memory(self) -> None:
        """Take the name off the shared memory, which then goes with its users, however these end.

        A hang-up also ends Python's own process that would else remove it.
        """
        if self._is_memory_linked:
            self._is_memory_linked = False
            self._memory.unlink()

    def _raise_if_ended(self) -> None:
        """Give up before it began, if that is asked for."""
        with suppress(BlockingIOError):
            self._end_signals.recv(1)
            raise KeyboardInterrupt

    def must_end_now(self) -> bool:
        """Tell whether it is to end at once, now that it ends; a closed terminal asks for nothing."""
        with suppress(BlockingIOError):
            if any(number != getattr(signal, "SIGHUP", None) for number in self._end_signals.recv(16)):
                self._must_end_now = True
        return self._must_end_now

    def _on_signal(self, _: int) -> None:
        """End; when the terminal is closed, go on without it until no client is left."""
        for number in self._end_signals.recv(16):
            if number == getattr(signal, "SIGHUP", None):
                self._is_terminal_closed = True
            else:
                self._begin_ending()

    def _begin_ending(self) -> None:
        """End in order, and at once when asked again."""
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
        """Do what is due from time to time."""
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
        """Take what the watcher says, if it does: how the open sessions can be ended, or nothing any more.

        The look around may have taken what the poller told of in the same breath; who waited here for more
        would wait for ever, as the watcher then waits for the relay.
        """
        try:
            if not self._watcher_pipe.poll():
                return
            self._closing_requests = json.loads(self._watcher_pipe.recv_bytes())
            self.relay.stop()
        except (EOFError, OSError):
            self._is_watched = False
            self.relay.unwatch(self._watcher_pipe.fileno())
            self._ring.detach_reader()
            _print_aside("watching has ended; the relay goes on, and nothing is recorded or shown any more")
            if self._ending_since:
                self.relay.stop()

    def _send_to_watcher(self, message: bytes) -> bool:
        """Say something to the watcher; tell whether it is there."""
        try:
            self._watcher_pipe.send_bytes(message)
        except OSError:
            return False
        return self._is_watched

    def _close_udp_sessions(self) -> None:
        """End the sessions of UDP clients at the controller, in their place, those that may move first."""
        until = time.monotonic() + _SESSIONS_CLOSE_WITHIN
        for number, state, requests in sorted(self._closing_requests, key=lambda goodbye: not goodbye[1]):
            session = self.relay.sessions.get(number)
            if not isinstance(session, UdpSession):
                continue
            if self.must_end_now():
                until = 0.0
            client, controller = session.conversation.client, session.conversation.server
            answered = session.send_closing_requests([bytes.fromhex(request) for request in requests], until)
            why = "no answer" if time.monotonic() < until else "there was no time"
            how = "was ended" if answered == len(requests) else f"could not be ended: {why}"
            what = f", where {state}," if state else ""
            self.relay.notify(f"the session of {client} at {controller}{what} {how}")


def _has_other_end(descriptor: int) -> bool:
    """Tell whether somebody is at the other end of a file descriptor; a file, or /dev/null, is at its end."""
    mode = os.fstat(descriptor).st_mode
    return stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode) or os.isatty(descriptor)


def _print_aside(text: str) -> threading.Thread:
    """Tell something in a thread of its own, as a terminal that is stopped takes nothing; return that.

    It writes past Python's buffer, whose lock the end of the program would wait for.
    """

    def write() -> None:
        with suppress(OSError):
            os.write(2, f"{ERASE_LINE if os.isatty(2) else ''}{text}\n".encode("utf-8", "replace"))

    aside = threading.Thread(target=write, name="aside", daemon=True)
    aside.start()
    return aside


def _shared_memory(size: int) -> SharedMemory:
    """Make memory that processes share, all of it there at once: a page that is missing later would kill."""
    try:
        if sys.platform != "win32":
            resource_tracker.ensure_running()  # who cannot start it later would leave the memory behind
        memory = SharedMemory(create=True, size=size)
        try:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(memory._fd, 0, size)  # type: ignore[attr-defined]  # no other way to it
        except OSError:
            memory.close()
            memory.unlink()
            raise
    except OSError as error:
        raise FileWriteError(Path("shared memory"), os_error_text(error)) from None
    assert memory.buf is not None
    memory.buf[:] = bytes(len(memory.buf))
    return memory
