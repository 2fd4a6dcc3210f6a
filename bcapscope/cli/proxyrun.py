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

from bcapscope.cli.courtesy import Courtesy, idle_priority
from bcapscope.cli.files import FileRefused
from bcapscope.cli.output import narrate
from bcapscope.cli.proxywishes import BEGIN, FAREWELL, INCOMPLETE, READY, Wishes, watch
from bcapscope.cli.screen import ERASE
from bcapscope.cli.signals import kept_from_ends
from bcapscope.cli.wakefulness import LightSleep, Wakefulness, passed
from bcapscope.player.realtime import undisturbed
from bcapscope.proxy.hook import Policy
from bcapscope.proxy.ports import open_ports
from bcapscope.proxy.relay import Relay
from bcapscope.proxy.ring import HEADER, RingWriter
from bcapscope.proxy.sockets import reason
from bcapscope.proxy.spec import Listener
from bcapscope.proxy.tcpport import TcpPort
from bcapscope.proxy.udp import UdpPort, UdpSession
from bcapscope.render.escape import printable
from bcapscope.traffic.observation import Endpoint
from bcapscope.transport.descriptors import allow_descriptors

RING_SIZE = 32 << 20
"""Bytes: twenty seconds of four robots with a set point each millisecond, if nobody watched at all."""

_DESCRIPTORS = 1024
"""Files that may be open: two for a TCP client, one for a UDP client and for one that is silent so far."""

_GLANCE = 0.05
_BEGINS_WITHIN = 30.0
_ANSWERS_WITHIN = 3.0
_ENDS_WITHIN = 60.0
"""Seconds that the watching process has."""

_GOODBYES_WITHIN = 3.0
"""Seconds for all sessions that are ended in their clients' place: a controller that is gone answers none."""

_LAST_WORDS_WITHIN = 0.5
"""Seconds that a terminal has for what is told at the end."""

_STDIN = 0

_SILENT = 30_000_000_000
"""ns after which a client is taken to have gone, once the terminal is closed."""


class Proxy:
    """A relay and what watches it.

    Attributes:
        relay: for callers that attach more to it before it runs.
        lacks_recording: after `close`: a recording was requested, and it is incomplete.
    """

    def __init__(
        self,
        wishes: Wishes,
        ends: socket.socket,
        policy: Policy | None = None,
        *,
        low_latency: bool = False,
    ) -> None:
        """Make a relay that listens nowhere yet.

        Args:
            wishes: of the watcher.
            ends: from which the signals come that end programs; see `awaited_ends`.
            policy: the rules; None without.
            low_latency: keep the machine's processors out of deep sleep while there is much traffic.

        Raises:
            FileRefused: there is no room for the memory that it shares with the watcher, or the system gives
                nothing to wait with.
        """
        self._wishes = wishes
        self._ends = ends
        allow_descriptors(_DESCRIPTORS)
        self._memory = _share(HEADER + RING_SIZE)
        self._is_named = True
        assert self._memory.buf is not None
        self._ring = RingWriter(self._memory.buf[: HEADER + RING_SIZE])
        self._context = multiprocessing.get_context("spawn")
        try:
            self.relay = Relay(self._ring, policy)
            self._link, self._other_end = self._context.Pipe()
        except OSError as error:
            self._release_memory()
            raise FileRefused(Path("the relay"), reason(error)) from None
        self._watcher: multiprocessing.process.BaseProcess | None = None
        self._watched = self._has_begun = False
        self.lacks_recording = False
        self._courtesy: Courtesy | None = None
        self._wakefulness = Wakefulness(LightSleep()) if low_latency else None
        self._ports: list[TcpPort | UdpPort] = []
        self._ending = 0.0
        self._hung_up = self._asked_again = False
        self._goodbyes: list[tuple[int, str, list[str]]] = []

    def listen(self, listener: Listener, forget_after: int) -> Endpoint:
        """Listen; return where. Clients are taken when it runs.

        Args:
            listener: where, and where to.
            forget_after: ns of silence after which a UDP client is forgotten.

        Raises:
            ListenError: it cannot be listened on.
            NoWay: the controller's name is unknown.
        """
        address, ports = open_ports(self.relay, listener, forget_after)
        self._ports += ports
        return address

    def start_watching(self, load: Callable[[float], bool] | None = None) -> None:
        """Start the process that watches, and wait until it does.

        Args:
            load: waits up to so many seconds for what else has to begin; returns whether it has. Nothing is
                recorded before, but the process is loaded meanwhile.

        Raises:
            FileRefused: the recording cannot be written, or no process be started.
            KeyboardInterrupt: it is to end already.
        """
        arguments = self._memory.name, self._other_end, self._wishes
        watcher = self._context.Process(target=watch, args=arguments, name="watch")
        try:
            with kept_from_ends():
                watcher.start()
        except OSError as error:
            raise FileRefused(Path("the process that watches"), reason(error)) from None
        self._watcher = watcher
        self._other_end.close()
        while load is not None and not load(_GLANCE):
            self._end_early()
        self._say(BEGIN)
        until = time.monotonic() + _BEGINS_WITHIN
        while not self._link.poll(_GLANCE) and time.monotonic() < until:
            self._end_early()
        try:
            answer = self._link.recv_bytes() if self._link.poll() else b"no answer"
        except (EOFError, OSError):
            answer = b"the process that writes it has ended"
        if answer != READY:
            raise FileRefused(self._wishes.record or Path("the recording"), answer.decode())
        self._watched = self._has_begun = True
        self._forget_name()
        if sys.platform != "win32":  # there a pipe cannot be waited for together with sockets
            self.relay.watch(self._link.fileno(), lambda _: self._hear())

    def attend(self) -> None:
        """Do as when the terminal is closed once standard input ends: whoever started the proxy is gone."""
        if sys.platform == "win32":  # there a pipe cannot be waited for together with sockets
            return
        if sys.stdin is None or not _can_last(_STDIN):
            self._hung_up = True
        else:
            self.relay.watch(_STDIN, self._listen_to_starter)

    def run(self, greet: Callable[[], None]) -> None:
        """Pass bytes on until told to end, then end in order; `start_watching` came before.

        Args:
            greet: called when clients are taken.

        Raises:
            KeyboardInterrupt: it is to end already.
        """
        self._end_early()
        self.relay.watch(self._ends.fileno(), self._signalled)
        # Beside busy programs one round trip in ten waited 4 ms without the priority. With it, Linux wakes
        # the relay where it ran last, not where its waker runs: that processor had better not sleep.
        with undisturbed() as grade:
            if not grade.realtime:
                self._say(grade.text.encode())
            # Not earlier: it tries something in a thread, whose stack stays, and would be locked as well.
            if self._watched:
                assert self._watcher is not None
                assert self._watcher.pid is not None
                self._courtesy = Courtesy(self._ring, idle_priority(self._watcher.pid))
            ports, self._ports = self._ports, []
            self.relay.listen(ports)
            greet()
            self.relay.run(self._look_around)
            self.relay.close_ports()
            self.relay.let_all_go()
            self._say_goodbye()
            self.relay.close()
            if self.relay.policy is not None:
                self.relay.policy.close(time.monotonic_ns())
                for line in self.relay.policy.report():
                    self.relay.tell(line)
            if not self._watched:
                self._sum_up()

    def _sum_up(self) -> None:
        """Tell what is known here, as who watched it tells nothing any more."""
        from bcapscope.cli.proxystatus import losses, totals  # the watcher's, and NumPy with it

        report = () if self.relay.policy is None else self.relay.policy.report()
        counts = self._ring.counts
        _aside("\n".join((*report, totals(counts), *losses(counts)))).join(_LAST_WORDS_WITHIN)

    def close(self) -> None:
        """Wait for the watcher's summary, unless asked once more to end, and let go of everything."""
        if self._wakefulness is not None:
            self._wakefulness.end()
        for port in self._ports:  # it gave up before the relay had them
            port.close()
            port.release()
        self._ports.clear()
        self.relay.close()
        self._link.close()
        if self._courtesy is not None:
            self._courtesy.end()
        if self._watcher is not None:
            if not self._watched:  # it has not begun, or has ended
                self._watcher.kill()
            until = time.monotonic() + _ENDS_WITHIN
            while self._watcher.is_alive() and time.monotonic() < until and not self.is_asked_again():
                self._watcher.join(_GLANCE)
            if self._watcher.is_alive():
                narrate("watching has not ended in time; the last part of the recording may be missing")
                self._watcher.kill()
                self._watcher.join(_ENDS_WITHIN)
            if self._has_begun:
                self._judge(self._watcher.exitcode)
            self._watcher = None
        self._release_memory()

    def _judge(self, code: int | None) -> None:
        """Decide by the exit code of the watcher whether the recording is complete."""
        self.lacks_recording = self._wishes.record is not None and code != 0
        if self.lacks_recording and code != INCOMPLETE:  # it could not say so itself
            narrate(f"{printable(str(self._wishes.record))} is incomplete: the recorder ended early")

    def _release_memory(self) -> None:
        self._ring.release()
        self._memory.close()
        self._forget_name()

    def _forget_name(self) -> None:
        """Take the name off the shared memory, which then goes with its users, however these end.

        A hang-up also ends Python's own process that would else remove it.
        """
        if self._is_named:
            self._is_named = False
            self._memory.unlink()

    def _end_early(self) -> None:
        """Give up before it began, if that is asked for."""
        with suppress(BlockingIOError):
            self._ends.recv(1)
            raise KeyboardInterrupt

    def is_asked_again(self) -> bool:
        """Tell whether it is to end at once, now that it ends; a closed terminal asks for nothing."""
        with suppress(BlockingIOError):
            if any(number != getattr(signal, "SIGHUP", None) for number in self._ends.recv(16)):
                self._asked_again = True
        return self._asked_again

    def _signalled(self, _: int) -> None:
        """End; when the terminal is closed, go on without it until no client is left."""
        for number in self._ends.recv(16):
            if number == getattr(signal, "SIGHUP", None):
                self._hung_up = True
            else:
                self._end()

    def _end(self) -> None:
        """End in order, and at once when asked again."""
        if self._courtesy is not None:
            self._courtesy.end()
        if self._ending or not self._say(FAREWELL):
            self.relay.stop()
        self._ending = time.monotonic()

    def _listen_to_starter(self, _: int) -> None:
        if not os.read(_STDIN, 1024):
            self.relay.unwatch(_STDIN)
            self._hung_up = True

    def _look_around(self) -> None:
        """Do what is due from time to time."""
        if self._wakefulness is not None:
            self._wakefulness.look(passed(self._ring.counts), time.monotonic())
        if self._watched and self._courtesy is not None:
            self._courtesy.look(time.monotonic())
        if self._ending and time.monotonic() - self._ending > _ANSWERS_WITHIN:
            self.relay.stop()
        if self._watched:
            self._hear()
        if self._hung_up and not self._ending:
            now = self.relay.now
            if all(now - session.heard > _SILENT for session in self.relay.sessions.values()):
                self._end()

    def _hear(self) -> None:
        """Take what the watcher says, if it does: how the open sessions can be ended, or nothing any more.

        The look around may have taken what the poller told of in the same breath; who waited here for more
        would wait for ever, as the watcher then waits for the relay.
        """
        try:
            if not self._link.poll():
                return
            self._goodbyes = json.loads(self._link.recv_bytes())
            self.relay.stop()
        except (EOFError, OSError):
            self._watched = False
            self.relay.unwatch(self._link.fileno())
            self._ring.abandon()
            _aside("watching has ended; the relay goes on, and nothing is recorded or shown any more")
            if self._ending:
                self.relay.stop()

    def _say(self, message: bytes) -> bool:
        """Say something to the watcher; tell whether it is there."""
        try:
            self._link.send_bytes(message)
        except OSError:
            return False
        return self._watched

    def _say_goodbye(self) -> None:
        """End the sessions of UDP clients at the controller, in their place, those that may move first."""
        until = time.monotonic() + _GOODBYES_WITHIN
        for number, state, requests in sorted(self._goodbyes, key=lambda goodbye: not goodbye[1]):
            session = self.relay.sessions.get(number)
            if not isinstance(session, UdpSession):
                continue
            if self.is_asked_again():
                until = 0.0
            client, controller = session.conversation.client, session.conversation.server
            answered = session.leave([bytes.fromhex(request) for request in requests], until)
            why = "no answer" if time.monotonic() < until else "there was no time"
            how = "was ended" if answered == len(requests) else f"could not be ended: {why}"
            what = f", where {state}," if state else ""
            self.relay.tell(f"the session of {client} at {controller}{what} {how}")


def _can_last(descriptor: int) -> bool:
    """Tell whether somebody is at the other end of a file descriptor; a file, or /dev/null, is at its end."""
    mode = os.fstat(descriptor).st_mode
    return stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode) or os.isatty(descriptor)


def _aside(text: str) -> threading.Thread:
    """Tell something in a thread of its own, as a terminal that is stopped takes nothing; return that.

    It writes past Python's buffer, whose lock the end of the program would wait for.
    """

    def write() -> None:
        with suppress(OSError):
            os.write(2, f"{ERASE if os.isatty(2) else ''}{text}\n".encode("utf-8", "replace"))

    aside = threading.Thread(target=write, name="aside", daemon=True)
    aside.start()
    return aside


def _share(size: int) -> SharedMemory:
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
        raise FileRefused(Path("shared memory"), reason(error)) from None
    assert memory.buf is not None
    memory.buf[:] = bytes(len(memory.buf))
    return memory
