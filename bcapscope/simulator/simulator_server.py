"""The sockets of the simulator: UDP and TCP on one port, served by one thread."""

from __future__ import annotations

import re
import select
import socket
import time
from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from typing import Protocol, TypeAlias

from bcapscope.protocol.first_frame import first_frame_stops
from bcapscope.simulator.listening_sockets import DatagramQueue, open_sockets
from bcapscope.simulator.simulator import STOP_CLIENTS, Peer, ResetMarker, SimulatorOutput
from bcapscope.simulator.simulator_clock import ClockedModel, SimulatorClock
from bcapscope.transport.descriptors import SpareDescriptors, accept_connection
from bcapscope.transport.first_frame_queue import FirstFrameQueue
from bcapscope.transport.receive_timestamps import (
    ANCILLARY_SIZE,
    AncillaryData,
    enable_receive_timestamps,
    kernel_timestamp,
    receive_function,
)
from bcapscope.transport.socket_link import close_with_reset

LARGEST_DATAGRAM = 65535
LARGEST_BACKLOG = 1 << 20
"""Maximum number of bytes that a client may leave unread before the server closes its connection."""

LONGEST_WAIT = 0.5
"""Longest wait for traffic in seconds. On every system, the server notices Ctrl-C within `LONGEST_WAIT`."""

# After a request, the server polls its sockets for this time in ns instead of sleeping. On a virtual machine,
# waking an idle processor takes longer than answering a call. The server does not yield the processor between
# two polls, because another program could then use the processor for a whole time slice.
_SPIN_NS = 60_000

_MAX_DATAGRAMS = 1024  # maximum number of datagrams to read in a row
_READ_SIZE = 256  # maximum number of bytes to read from one connection in a row
_READ_SIZE_PACED = 16384  # maximum number of bytes per read in modes where the client sets the pace
# Matches between the end of a frame (0x04) and the start of the next frame (0x01). The bytes 0x04 0x01 can
# also occur inside a frame. The server then delivers this frame in two pieces, which is harmless.
_BETWEEN_FRAMES = re.compile(rb"(?<=\x04)(?=\x01)")
_MAX_ACCEPTED = 16  # maximum number of connections accepted in a row
_SPARE_DESCRIPTORS = 3  # number of file descriptors reserved for clients that send a stop
_TIDY_INTERVAL_NS = 1_000_000_000  # ns

_SAME_MOMENT_NS = 2_000_000  # time in ns; set points that arrive within this time belong to one cycle

Address: TypeAlias = tuple[str, int]
ReadyDescriptors: TypeAlias = tuple[list[int], list[int]]
"""Readable file descriptors, and writable file descriptors."""


class TrafficTap(Protocol):
    """Receives all traffic of the server. Addresses are host and port; times are in ns since 1970.

    `on_stream_end` means that one end closed or reset a TCP connection. `on_connection_end` means that the
    connection ended in both directions.
    """

    def on_datagram(self, source: Address, target: Address, data: bytes, time: int) -> None: ...
    def on_segment(self, source: Address, target: Address, data: bytes, time: int) -> None: ...
    def on_stream_end(self, source: Address, target: Address, time: int, *, reset: bool = False) -> None: ...
    def on_connection_end(self, client: Address, server: Address) -> None: ...


class ControllerModel(ClockedModel, Protocol):
    def on_datagram(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]: ...
    def on_connect(self, peer: Peer, now: int, is_stop: bool = False) -> bool: ...
    def on_segment(self, peer: Peer, data: bytes, now: int) -> list[SimulatorOutput]: ...
    def on_disconnect(self, peer: Peer, now: int) -> None: ...
    def reset(self, now: int) -> list[SimulatorOutput]: ...
    def advance(self, now: int) -> list[SimulatorOutput]: ...


class _Connection:
    __slots__ = ("backlog", "client", "is_blocked", "last_heard", "number", "peer", "receive", "socket")

    def __init__(self, sock: socket.socket, address: Address) -> None:
        self.socket = sock
        self.number = sock.fileno()
        self.receive = receive_function(sock)
        self.last_heard = 0
        self.client: Address = address[:2]
        self.peer = ("tcp", address)
        self.backlog = bytearray()
        self.is_blocked = False


class SimulatorServer:
    """Moves bytes between sockets and a simulator; `tap` receives all traffic.

    Each request keeps the arrival time that Linux records. If the server reads several requests at once from
    a TCP connection, Linux reports only when the last byte arrived. In modes where the client sets the pace,
    the server may read several set points together. The server spreads the arrival times of these set points
    evenly over the time since the client's previous bytes arrived.
    """

    def __init__(self, simulator: ControllerModel, host: str, port: int) -> None:
        """Listen on UDP and TCP, or raise SimulatorListenError; port 0 picks a port that is free for both."""
        self._model = simulator
        self.tap: TrafficTap | None = None
        self.datagram_queue = DatagramQueue()
        self._connections: dict[int, _Connection] = {}
        self._by_peer: dict[object, _Connection] = {}
        self._lobby: FirstFrameQueue[int] = FirstFrameQueue()
        # connections that were accepted only because their first request was a stop, oldest first
        self._stops: list[_Connection] = []
        self._spares = SpareDescriptors(_SPARE_DESCRIPTORS)
        self._is_paused = False
        # the first `step` reserves the spare descriptors, after the program has opened its own descriptors
        self._tidied_at = -_TIDY_INTERVAL_NS
        self._spin_until = 0
        self._may_be_more = True
        self._polled_empty_at = 0  # time of the latest poll that found no data
        self._clock = SimulatorClock(simulator)
        self._udp, self._tcp = open_sockets(host, port)
        self._udp_descriptor, self._tcp_descriptor = self._udp.fileno(), self._tcp.fileno()
        self._receive = receive_function(self._udp)
        self._readers: list[int] = [self._udp_descriptor, self._tcp_descriptor]
        self._writers: list[int] = []
        self.address: Address = self._tcp.getsockname()[:2]

    def now(self) -> int:
        return self._clock.now()

    def close(self) -> None:
        for connection in list(self._connections.values()):
            self._drop(connection)
        self._udp.close()
        self._tcp.close()
        self._spares.close()

    def step(self, until: float = LONGEST_WAIT, extra: Sequence[int] = ()) -> list[int]:
        """Wait up to `until` seconds for traffic, and process the traffic. Return the descriptors in `extra`
        that became readable.
        """
        now = self._clock.now()
        self._tidy()
        due = self._model.due(now)
        readers = [*self._readers, *extra]
        readable, writable = self._wait(readers, 0 if self.datagram_queue.waiting else until, due, now)
        moment = self._clock.update()
        if due is not None and due <= moment:  # requests that arrived before the due time are processed first
            readable, writable = self._select(readers, 0)
            self._may_be_more = True
        for blocked in writable:
            self._flush(self._connections[blocked])
        for source in readable:
            if source not in extra:
                self._read_socket(source, len(readable) > 2)
        if self.datagram_queue.waiting:
            self._deliver_queued()
        now = self._clock.now()
        if readable:
            self._spin_until = now + _SPIN_NS
        moment = min(moment, now)  # processing the requests may have paused the clock
        if self.datagram_queue.waiting:
            moment = min(moment, self.datagram_queue.oldest_arrival)
        if due is not None and due <= moment:
            self._send(self._model.advance(self._clock.make_monotonic(moment)))
            self._clock.on_replies_sent()
        return [source for source in readable if source in extra] if extra else []

    def reset(self) -> None:
        self._send(self._model.reset(self._monotonic_now()))

    def _monotonic_now(self) -> int:
        return self._clock.make_monotonic(self._clock.update())

    def _wait(self, readers: list[int], until: float, due: int | None, now: int) -> ReadyDescriptors:
        """Wait for readable and writable sockets; shortly after a request, poll instead of sleeping.

        If a poll finds no bytes and the next poll finds some, these bytes arrived between the two polls.
        """
        end = self._spin_until if due is None else min(self._spin_until, due)
        self._may_be_more = True
        while now < end and until:
            readable, writable = self._select(readers, 0)
            if readable or writable:
                self._polled_empty_at = now
                return readable, writable
            self._may_be_more = False
            now = self._clock.now()
        self._may_be_more = True
        wait = until if due is None else min(until, max(0, due - now) / 1e9)
        return self._select(readers, wait)

    def _select(self, readers: list[int], seconds: float) -> ReadyDescriptors:
        """`select` is used, because `epoll` refuses a file as stdin, and `poll` waits for 1 ms or longer."""
        readable, writable, _ = select.select(readers, self._writers, (), seconds)
        return readable, writable

    def _read_socket(self, source: int, is_crowded: bool) -> None:
        """Read from the socket `source`. `is_crowded` means that more than two sockets are readable. The
        server then also reads the waiting datagrams after each TCP segment.
        """
        if source == self._udp_descriptor:
            self._read_datagrams()
        elif source == self._tcp_descriptor:
            self._accept()
        else:
            self._read_segment(source)
            if is_crowded:
                self._read_datagrams()
                self._deliver_queued()

    def _read_datagrams(self) -> None:
        """Read the waiting datagrams. If `datagram_queue` is empty, answer the first datagram at once. Add
        all other datagrams to `datagram_queue`.
        """
        receive, turns = self._receive, self.datagram_queue
        # If `_may_be_more` is False, `_arrival_time` does not need an arrival time from the operating system.
        asked = ANCILLARY_SIZE if self._may_be_more else 0
        for number in range(_MAX_DATAGRAMS if self._may_be_more else 1):
            try:
                data, control, _, address = receive(LARGEST_DATAGRAM, asked)
            except OSError:  # no data is left or, on Windows, an earlier client closed its port
                return
            if self.tap:
                self.tap.on_datagram(address[:2], self.address, data, time.time_ns())
            if number or turns.waiting:
                turns.add(address, self._arrival_time(control), data)
            else:
                self._deliver_datagram(address, self._arrival_time(control), data)

    def _deliver_queued(self) -> None:
        for address, came, data in self.datagram_queue.pop_one_per_sender():
            self._deliver_datagram(address, came, data)

    def _deliver_datagram(self, address: Hashable, came: int, data: bytes) -> None:
        self._send(self._model.on_datagram(("udp", address), data, self._clock.make_monotonic(came)))
        self._clock.on_replies_sent()

    def _arrival_time(self, control: AncillaryData) -> int:
        if not self._may_be_more:
            return self._polled_empty_at
        return self._clock.arrival_time(kernel_timestamp(control, 0))

    def _accept(self) -> None:
        """Accept connections; a connection becomes a client once its first frame arrives."""
        for _ in range(_MAX_ACCEPTED):
            try:
                if (accepted := accept_connection(self._tcp, self._free_descriptor)) is None:
                    break
            except OSError:
                self._is_paused = True  # otherwise `select` would immediately report this client again
                break
            sock, address = accepted
            sock.setblocking(False)
            with suppress(OSError):  # macOS refuses options for a client that is already gone
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            enable_receive_timestamps(sock)
            connection = _Connection(sock, address)
            self._drop_newcomer(self._lobby.add(connection.number, address[0]))
            self._connections[connection.number] = self._by_peer[connection.peer] = connection
        self._choose_sockets()

    def _drop_newcomer(self, number: int | None) -> bool:
        """Close a connection that has sent no frame yet. Return False if there is no such connection."""
        if number is None:
            return False
        self._drop(self._connections[number], by_reset=True)
        return True

    def _free_descriptor(self) -> bool:
        is_freed = self._spares.release_one() or self._drop_newcomer(self._lobby.drop_one())
        if not is_freed and self._stops:
            self._drop(self._stops[0])
            return True
        return is_freed

    def _tidy(self) -> None:
        """Once a second, close overdue connections. After a lack of descriptors, accept connections again."""
        now = time.monotonic_ns()
        if now - self._tidied_at < _TIDY_INTERVAL_NS:
            return
        self._tidied_at = now
        self._spares.refill()
        for number in self._lobby.drop_overdue(now):
            self._drop_newcomer(number)
        if self._is_paused:
            self._is_paused = False
            self._choose_sockets()

    def _admit(self, connection: _Connection, first: bytes) -> bool:
        """Accept a new client. A full server closes the connection unless the first request is a stop."""
        is_stop = first_frame_stops(first)
        has_room = self._spares.refill() and self._model.on_connect(connection.peer, self._monotonic_now())
        if not has_room and is_stop:
            if len(self._stops) >= STOP_CLIENTS:
                self._drop(self._stops[0])
            has_room = self._model.on_connect(connection.peer, self._monotonic_now(), is_stop=True)
            self._stops.append(connection)
        if not has_room:
            self._drop(connection)
        return has_room

    def _choose_sockets(self) -> None:
        """Choose the sockets to wait for. The server does not read from a client that reads no replies."""
        connections = self._connections.items()
        self._writers = [number for number, each in connections if each.is_blocked]
        listeners = () if self._is_paused else (self._tcp_descriptor,)
        own = (number for number, each in connections if not each.is_blocked)
        self._readers = [self._udp_descriptor, *listeners, *own]

    def _read_segment(self, number: int) -> None:
        connection = self._connections.get(number)
        if connection is None:
            return
        goes_on = self._model.runs_in_real_time
        most, asked = _READ_SIZE_PACED if goes_on else _READ_SIZE, ANCILLARY_SIZE if self._may_be_more else 0
        try:
            data, control, _, _ = connection.receive(most, asked)
        except BlockingIOError:
            return
        except OSError as error:
            self._drop_broken(connection, error)
            return
        if not data:
            if self.tap:
                self.tap.on_stream_end(connection.client, self.address, time.time_ns())
            self._drop(connection)
            return
        if number in self._lobby:
            first = self._lobby.feed_bytes(number, data, time.monotonic_ns())
            if first is None or not self._admit(connection, first):
                return
            data = first
        if self.tap:
            self.tap.on_segment(connection.client, self.address, data, time.time_ns())
        came, since = self._arrival_time(control), connection.last_heard
        connection.last_heard = came
        if goes_on and came - since > _SAME_MOMENT_NS:
            self._deliver_spread(connection, data, since, came)
        else:
            self._deliver_segment(connection, data, came)

    def _deliver_spread(self, connection: _Connection, data: bytes, since: int, came: int) -> None:
        """Process frames as if their bytes had arrived at a constant rate from the time `since` to `came`."""
        taken = 0
        for piece in _BETWEEN_FRAMES.split(data):
            taken += len(piece)
            self._deliver_segment(connection, piece, since + (came - since) * taken // len(data))
            if connection.number not in self._connections:
                return

    def _deliver_segment(self, connection: _Connection, data: bytes, came: int) -> None:
        self._send(self._model.on_segment(connection.peer, data, self._clock.make_monotonic(came)))
        self._clock.on_replies_sent()

    def _send(self, outputs: list[SimulatorOutput]) -> None:
        for peer, data in outputs:
            connection = self._by_peer.get(peer)
            if connection is None:
                assert isinstance(peer, tuple)
                if peer[0] == "udp":
                    if self.tap:
                        self.tap.on_datagram(self.address, peer[1][:2], data, time.time_ns())
                    try:
                        self._udp.sendto(data, peer[1])
                    except OSError:  # the client is gone, or the socket's buffer is full
                        continue
            elif not data or len(connection.backlog) > LARGEST_BACKLOG:
                self._drop(connection, by_reset=isinstance(data, ResetMarker))
            else:
                connection.backlog += data
                if not connection.is_blocked:
                    self._flush(connection)

    def _flush(self, connection: _Connection) -> None:
        backlog = connection.backlog
        try:
            sent = connection.socket.send(backlog)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            self._drop_broken(connection, error)
            return
        if self.tap and sent:
            self.tap.on_segment(self.address, connection.client, bytes(backlog[:sent]), time.time_ns())
        del backlog[:sent]
        if connection.is_blocked is not bool(backlog):
            connection.is_blocked = bool(backlog)
            self._choose_sockets()

    def _drop_broken(self, connection: _Connection, error: OSError) -> None:
        if self.tap and isinstance(error, ConnectionError):
            self.tap.on_stream_end(connection.client, self.address, time.time_ns(), reset=True)
        self._drop(connection, is_broken=True)

    def _drop(self, connection: _Connection, by_reset: bool = False, is_broken: bool = False) -> None:
        if self._connections.pop(connection.number, None) is None:
            return
        del self._by_peer[connection.peer]
        self._lobby.remove(connection.number)
        self._stops = [each for each in self._stops if each is not connection]
        self._choose_sockets()
        if self.tap:
            if not is_broken:
                self.tap.on_stream_end(self.address, connection.client, time.time_ns(), reset=by_reset)
            self.tap.on_connection_end(connection.client, self.address)
        self._model.on_disconnect(connection.peer, self._monotonic_now())
        if by_reset:
            close_with_reset(connection.socket)
        else:
            connection.socket.close()


def serve(
    server: SimulatorServer, idle: Callable[[], bool], on_readable: Callable[[int], None], extra: list[int]
) -> None:
    """Serve until interrupted, and call `idle` after each step; `idle` returns whether it has more work.

    `extra` lists further file descriptors to watch, such as standard input. When one of these becomes
    readable, `on_readable` is called with the descriptor. `on_readable` may remove descriptors from the list.
    """
    is_busy = False
    while True:
        for ready in server.step(0 if is_busy else LONGEST_WAIT, extra):
            on_readable(ready)
        is_busy = idle()
