"""The sockets of the simulator: UDP and TCP on one port, one thread, no more waiting than needed.

There are never more sockets than clients, 20 on TCP and a few that send stops, connections that have not sent
a frame yet, and those who serve.
"""

from __future__ import annotations

import re
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Protocol, TypeAlias

from bcapscope.protocol.opening import begins_with_stop
from bcapscope.simulator.clock import Clock
from bcapscope.simulator.listening import listen
from bcapscope.simulator.simulator import KEPT, Abort, Output, Peer
from bcapscope.simulator.turns import Turns
from bcapscope.simulator.watch import Ready, Watch
from bcapscope.transport.arrival import CONTROL, Control, ask_for_times, kernel_time, receiver
from bcapscope.transport.descriptors import SpareDescriptors, accept
from bcapscope.transport.lobby import Lobby
from bcapscope.transport.tcp import reset

LARGEST_DATAGRAM = 65535
LARGEST_BACKLOG = 1 << 20
"""Bytes that a client may leave unread before its connection is closed."""

LONGEST_WAIT = 0.5
"""Seconds; an interrupt is noticed after that at the latest on every system."""

# ns. To wake a processor that has nothing to do takes longer, on a virtual machine, than to answer a call.
# Yielding meanwhile would cost a whole time slice wherever another program runs.
_LINGER = 60_000

_AT_ONCE = 1024  # datagrams that are taken from the system before any but the first is looked at
_PORTION = 256  # bytes that are taken of a connection before the others have their turn
_PILE = 16384  # the same where each set point has its own time
_BETWEEN_FRAMES = re.compile(rb"(?<=\x04)(?=\x01)")  # or what looks like it, which does no harm
_MOST_ACCEPTED = 16  # connections that are taken before others have their turn
_SPARE_DESCRIPTORS = 3  # for clients that may turn out to send a stop when there are no others
_TIDY_EACH = 1_000_000_000  # ns

_AT_ONE_TIME = 2_000_000  # ns; what comes within it is no pile of set points for different cycles

Address: TypeAlias = tuple[str, int]
_Address: TypeAlias = "tuple[Any, ...]"  # two values, four with IPv6


class Tap(Protocol):
    """Is shown what passes; addresses are host and port, times ns since 1970."""

    def datagram(self, source: Address, target: Address, data: bytes, time: int) -> None:
        """Take a UDP datagram."""

    def segment(self, source: Address, target: Address, data: bytes, time: int) -> None:
        """Take bytes of a TCP connection."""

    def finished(self, source: Address, target: Address, time: int, *, reset: bool = False) -> None:
        """Take notice that an end of a TCP connection sends nothing more, or has broken it off."""

    def ended(self, client: Address, server: Address) -> None:
        """Take notice that nothing more comes of a TCP connection."""


class Answerer(Protocol):
    """What says what to answer, such as a `Simulator`, whose methods these are."""

    @property
    def keeps_time(self) -> bool: ...
    @property
    def waits(self) -> bool: ...
    def datagram(self, peer: Peer, data: bytes, now: int) -> list[Output]: ...
    def connect(self, peer: Peer, now: int, is_stop: bool = False) -> bool: ...
    def segment(self, peer: Peer, data: bytes, now: int) -> list[Output]: ...
    def disconnect(self, peer: Peer, now: int) -> None: ...
    def reset(self, now: int) -> list[Output]: ...
    def advance(self, now: int) -> list[Output]: ...
    def due(self, now: int) -> int | None: ...


class _Connection:
    """A TCP client: its socket and what could not be sent yet."""

    __slots__ = ("backlog", "blocked", "client", "heard", "number", "peer", "receive", "socket")

    def __init__(self, sock: socket.socket, address: Address) -> None:
        self.socket = sock
        self.number = sock.fileno()
        self.receive = receiver(sock)
        self.heard = 0
        self.client: Address = address[:2]
        self.peer = ("tcp", address)
        self.backlog = bytearray()
        self.blocked = False


class Server:
    """Moves bytes between sockets and a simulator.

    Its time is that of a `Clock`: what comes is heard as of when it came, which Linux tells. On TCP it tells
    that of the last byte only: where set points have piled up that wait for no reply, those before the last
    are taken as having come evenly since the client's last but those. Elsewhere a pile is one jump.

    Attributes:
        address: host and port that it listens on.
        tap: is shown all that passes; None for nobody.
        turns: datagrams that wait.
    """

    def __init__(self, simulator: Answerer, host: str, port: int) -> None:
        """Listen on UDP and TCP.

        Args:
            simulator: whose time is that of `now`, which begins as `time.monotonic_ns`.
            host: address or name of this machine.
            port: 0 for any that is free on both.

        Raises:
            ListenError: that cannot be done.
        """
        self._simulator = simulator
        self.tap: Tap | None = None
        self.turns: Turns[_Address] = Turns()
        self._connections: dict[int, _Connection] = {}
        self._by_peer: dict[object, _Connection] = {}
        self._lobby: Lobby[int] = Lobby()
        self._stops: list[_Connection] = []  # beyond the controller's limit, the oldest first
        self._spares = SpareDescriptors(_SPARE_DESCRIPTORS)
        self._is_paused = False
        self._tidied = -_TIDY_EACH  # not earlier: what the command needs to run comes before spares
        self._awake_until = 0
        self._may_be_more = True
        self._moment = 0  # before which nothing was there
        self._clock = Clock(simulator)
        self._udp, self._tcp = listen(host, port)
        self._datagrams, self._newcomers = self._udp.fileno(), self._tcp.fileno()
        self._receive = receiver(self._udp)
        self._also: tuple[int, ...] = ()
        self._watch = Watch((), ())
        self._is_rearranged = True
        self.address: tuple[str, int] = self._tcp.getsockname()[:2]

    def now(self) -> int:
        """Return the controller's time, ns."""
        return self._clock.now()

    def close(self) -> None:
        """Close all sockets."""
        for connection in list(self._connections.values()):
            self._drop(connection)
        self._udp.close()
        self._tcp.close()
        self._spares.close()

    def step(self, until: float = LONGEST_WAIT, also: Sequence[int] = ()) -> list[int]:
        """Wait for one thing to do and do it.

        Args:
            until: seconds to wait at most.
            also: other file descriptors to wait for.

        Returns:
            Those of `also` that can be read.
        """
        now = self._clock.now()
        self._tidy()
        due = self._simulator.due(now)
        if self._also != (others := tuple(also)):
            self._also = others
            self._is_rearranged = True
        if self._is_rearranged:
            self._arrange()
        readable, writable = self._wait(0 if self.turns.waiting else until, due, now)
        moment = self._clock.look()
        if due is not None and due <= moment:  # whatever came before that is heard before it
            readable, writable = self._watch.look()
            self._may_be_more = True
        for blocked in writable:
            self._flush(self._connections[blocked])
        for source in readable:
            if source not in others:
                self._take(source, len(readable) > 2)
        if self.turns.waiting:
            self._hear_turns()
        now = self._clock.now()
        if readable:
            self._awake_until = now + _LINGER
        moment = min(moment, now)  # what was heard may have set it back
        if self.turns.waiting:
            moment = min(moment, self.turns.since)
        if due is not None and due <= moment:
            self._send(self._simulator.advance(self._clock.tell(moment)))
            self._clock.answered()
        return [source for source in readable if source in others] if others else []

    def reset(self) -> None:
        """Press the pendant's Reset button."""
        self._send(self._simulator.reset(self._tell_now()))

    def _tell_now(self) -> int:
        return self._clock.tell(self._clock.look())

    def _wait(self, until: float, due: int | None, now: int) -> Ready:
        """Wait for sockets that can be read and written; shortly behind a request without going to sleep.

        What comes between two looks has come alone, or the next look finds more.
        """
        end = self._awake_until if due is None else min(self._awake_until, due)
        self._may_be_more = True
        look = self._watch.look
        while now < end and until:
            readable, writable = look()
            if readable or writable:
                self._moment = now
                return readable, writable
            self._may_be_more = False
            now = self._clock.now()
        self._may_be_more = True
        wait = until if due is None else min(until, max(0, due - now) / 1e9)
        return self._watch.wait(wait)

    def _take(self, source: int, is_crowded: bool) -> None:
        """Take what has come at a socket; datagrams need not wait for a crowd of connections."""
        if source == self._datagrams:
            self._take_datagrams()
        elif source == self._newcomers:
            self._accept()
        else:
            self._take_segment(source)
            if is_crowded:
                self._take_datagrams()
                self._hear_turns()

    def _take_datagrams(self) -> None:
        """Take datagrams from the system before it runs out of room: the first is answered at once."""
        receive, turns = self._receive, self.turns
        asked = CONTROL if self._may_be_more else 0  # what has come between two looks came then
        for number in range(_AT_ONCE if self._may_be_more else 1):
            try:
                data, control, _, address = receive(LARGEST_DATAGRAM, asked)
            except OSError:  # nothing left; on Windows also an earlier client's closed port
                return
            if self.tap:
                self.tap.datagram(address[:2], self.address, data, time.time_ns())
            if number or turns.waiting:
                turns.add(address, self._came(control), data)
            else:
                self._hear(address, self._came(control), data)

    def _hear_turns(self) -> None:
        for address, came, data in self.turns.take():
            self._hear(address, came, data)

    def _hear(self, address: _Address, came: int, data: bytes) -> None:
        self._send(self._simulator.datagram(("udp", address), data, self._clock.tell(came)))
        self._clock.answered()

    def _came(self, control: Control) -> int:
        """Return when something came that was just taken from the system."""
        return self._clock.as_of(kernel_time(control, 0)) if self._may_be_more else self._moment

    def _accept(self) -> None:
        """Take connections; they are clients of the controller with their first frame."""
        for _ in range(_MOST_ACCEPTED):
            try:
                if (accepted := accept(self._tcp, self._free_descriptor)) is None:
                    break
            except OSError:
                self._is_paused = True  # or it would be told again and again that somebody waits
                break
            sock, address = accepted
            sock.setblocking(False)
            with suppress(OSError):  # on macOS a client that has gone by now has no options any more
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            ask_for_times(sock)
            connection = _Connection(sock, address)
            self._drop_newcomer(self._lobby.enter(connection.number, address[0]))
            self._connections[connection.number] = self._by_peer[connection.peer] = connection
        self._is_rearranged = True

    def _drop_newcomer(self, number: int | None) -> bool:
        """Close a connection that left the lobby for another; return whether there was one."""
        if number is None:
            return False
        self._drop(self._connections[number], by_reset=True)
        return True

    def _free_descriptor(self) -> bool:
        is_freed = self._spares.give() or self._drop_newcomer(self._lobby.drop())
        if not is_freed and self._stops:
            self._drop(self._stops[0])
            return True
        return is_freed

    def _tidy(self) -> None:
        """Once a second, end what takes too long and look again for what there was no room for."""
        now = time.monotonic_ns()
        if now - self._tidied < _TIDY_EACH:
            return
        self._tidied = now
        self._spares.fill()
        for number in self._lobby.overdue(now):
            self._drop_newcomer(number)
        if self._is_paused:
            self._is_paused = False
            self._is_rearranged = True

    def _admit(self, connection: _Connection, first: bytes) -> bool:
        """Make a connection a client of the controller; else close it. A stop always gets in."""
        is_stop = begins_with_stop(first)
        has_room = self._spares.fill() and self._simulator.connect(connection.peer, self._tell_now())
        if not has_room and is_stop:
            if len(self._stops) >= KEPT:
                self._drop(self._stops[0])
            has_room = self._simulator.connect(connection.peer, self._tell_now(), is_stop=True)
            self._stops.append(connection)
        if not has_room:
            self._drop(connection)
        return has_room

    def _arrange(self) -> None:
        """Say anew what is waited for: a client that does not read is not read from either."""
        self._is_rearranged = False
        connections = self._connections.items()
        writers = [number for number, each in connections if each.blocked]
        own = (number for number, each in connections if not each.blocked)
        listeners = [self._datagrams] if self._is_paused else [self._datagrams, self._newcomers]
        self._watch = Watch([*listeners, *own, *self._also], writers)

    def _take_segment(self, number: int) -> None:
        connection = self._connections.get(number)
        if connection is None:
            return
        goes_on = self._simulator.keeps_time
        most, asked = _PILE if goes_on else _PORTION, CONTROL if self._may_be_more else 0
        try:
            data, control, _, _ = connection.receive(most, asked)
        except BlockingIOError:
            return
        except OSError as error:
            self._part_from(connection, error)
            return
        if not data:
            if self.tap:
                self.tap.finished(connection.client, self.address, time.time_ns())
            self._drop(connection)
            return
        if number in self._lobby:
            first = self._lobby.feed(number, data, time.monotonic_ns())
            if first is None or not self._admit(connection, first):
                return
            data = first
        if self.tap:
            self.tap.segment(connection.client, self.address, data, time.time_ns())
        came, since = self._came(control), connection.heard
        connection.heard = came
        if goes_on and came - since > _AT_ONE_TIME:
            self._hear_evenly(connection, data, since, came)
        else:
            self._hear_segment(connection, data, came)

    def _hear_evenly(self, connection: _Connection, data: bytes, since: int, came: int) -> None:
        """Hear bytes as if they had come evenly between two times."""
        taken = 0
        for piece in _BETWEEN_FRAMES.split(data):
            taken += len(piece)
            self._hear_segment(connection, piece, since + (came - since) * taken // len(data))
            if connection.number not in self._connections:
                return

    def _hear_segment(self, connection: _Connection, data: bytes, came: int) -> None:
        self._send(self._simulator.segment(connection.peer, data, self._clock.tell(came)))
        self._clock.answered()

    def _send(self, outputs: list[Output]) -> None:
        for peer, data in outputs:
            connection = self._by_peer.get(peer)
            if connection is None:
                assert isinstance(peer, tuple)
                if peer[0] == "udp":
                    if self.tap:
                        self.tap.datagram(self.address, peer[1][:2], data, time.time_ns())
                    try:
                        self._udp.sendto(data, peer[1])
                    except OSError:  # the client is gone, or its socket's buffer is full
                        continue
            elif not data or len(connection.backlog) > LARGEST_BACKLOG:
                self._drop(connection, by_reset=isinstance(data, Abort))
            else:
                connection.backlog += data
                if not connection.blocked:
                    self._flush(connection)

    def _flush(self, connection: _Connection) -> None:
        backlog = connection.backlog
        try:
            sent = connection.socket.send(backlog)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            self._part_from(connection, error)
            return
        if self.tap and sent:
            self.tap.segment(self.address, connection.client, bytes(backlog[:sent]), time.time_ns())
        del backlog[:sent]
        if connection.blocked is not bool(backlog):
            connection.blocked = bool(backlog)
            self._is_rearranged = True

    def _part_from(self, connection: _Connection, error: OSError) -> None:
        """Let go of a client that has reset its connection, or cannot be reached any more."""
        if self.tap and isinstance(error, ConnectionError):
            self.tap.finished(connection.client, self.address, time.time_ns(), reset=True)
        self._drop(connection, is_broken=True)

    def _drop(self, connection: _Connection, by_reset: bool = False, is_broken: bool = False) -> None:
        if self._connections.pop(connection.number, None) is None:
            return
        del self._by_peer[connection.peer]
        self._lobby.leave(connection.number)
        self._stops = [each for each in self._stops if each is not connection]
        self._is_rearranged = True
        if self.tap:
            if not is_broken:
                self.tap.finished(self.address, connection.client, time.time_ns(), reset=by_reset)
            self.tap.ended(connection.client, self.address)
        self._simulator.disconnect(connection.peer, self._tell_now())
        if by_reset:
            reset(connection.socket)
        else:
            connection.socket.close()


def serve(server: Server, idle: Callable[[], bool], also: Callable[[int], None], watch: list[int]) -> None:
    """Serve until interrupted.

    Args:
        server: that listens.
        idle: called after each step; returns whether it has more to do.
        also: called with each of `watch` that can be read.
        watch: file descriptors; `also` may change it.
    """
    is_busy = False
    while True:
        for ready in server.step(0 if is_busy else LONGEST_WAIT, watch):
            also(ready)
        is_busy = idle()
