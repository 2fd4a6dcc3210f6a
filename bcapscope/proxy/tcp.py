"""Streams: half-close, reset and back-pressure pass through."""

from __future__ import annotations

import errno
import socket
import time
from contextlib import suppress

from bcapscope.proxy.poller import ERROR, HANG_UP, READ, WRITE
from bcapscope.proxy.relay import Relay, conversation
from bcapscope.proxy.ring import Count, Kind
from bcapscope.proxy.sockets import SocketAddress, endpoint_of, keep_alive, reason
from bcapscope.traffic.observation import Endpoint, Transport
from bcapscope.transport.lobby import source_of
from bcapscope.transport.tcp import reset

CONNECT_WITHIN = 10_000_000_000
"""ns."""

ANSWER_WITHIN = 200_000_000_000
"""ns for which a client that has ended its side may wait for a reply: a call may run 180 s, the default of
InvokeTimeout (orin_bcap C/src/bCAPServer/bcap_server.c)."""

STUCK_FOR = 10_000_000_000
"""ns without a byte after which a connection ends of which only the controller's side has, and after which a
connection that is half closed, or does not read, gives its place to a new client."""

ANSWERED_FOR = 1_000_000_000
"""The same where the client has ended its side and something has come for it since."""

MOST_PENDING = 1 << 18
"""Bytes that rules may hand over for a peer that does not read, before nothing more is read for it. Without
rules it is what one read gave."""

_AT_ONCE = 1 << 16

_RESETS = errno.ECONNRESET, errno.EPIPE
"""What the system says of a connection that its peer has reset."""


class _Half:
    """One direction of a connection.

    Attributes:
        up: from client to controller.
        source: what is read.
        sink: what is written.
        pending: what could not be written yet.
        ended: the source has ended.
        shut: and the sink was told.
    """

    __slots__ = ("ended", "pending", "shut", "sink", "source", "up")

    def __init__(self, up: bool, source: socket.socket, sink: socket.socket) -> None:
        self.up = up
        self.source = source
        self.sink = sink
        self.pending = bytearray()
        self.ended = self.shut = False


class TcpSession:
    """A client and its connection to the controller.

    Attributes:
        number: of the client.
        conversation: between the client and the controller.
        source: where the client comes from.
        heard: `Relay.now` when the client was last heard.
    """

    def __init__(
        self,
        relay: Relay,
        to: Endpoint,
        ends: tuple[socket.socket, socket.socket],
        address: SocketAddress,
        first: tuple[bytes, int],
    ) -> None:
        """Take in a client.

        Args:
            relay: whose it is.
            to: the controller as the user names it.
            ends: the client's connection, and the one to the controller, which is being made.
            address: of the client.
            first: what it has sent so far, and when that came, ns since 1970.
        """
        client, server = ends
        for sock in ends:
            sock.setblocking(False)
            with suppress(OSError):  # on macOS a client that has gone by now has no options any more
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                keep_alive(sock)
        self.number = relay.next_number()
        self.conversation = conversation(endpoint_of(address), to, Transport.TCP)
        self.source = source_of(address[0])
        self.heard = self._moved = relay.now
        self._first = first
        self._relay = relay
        self._to = to
        self._client = client
        self._server = server
        self._up = _Half(True, client, server)
        self._down = _Half(False, server, client)
        self._connected = self._closed = self._buried = self._ending = self._is_answered = False
        self._masks: dict[int, int | None] = {client.fileno(): 0, server.fileno(): WRITE}
        relay.watch(client.fileno(), self._client_happened, 0)
        relay.watch(server.fileno(), self._server_happened, WRITE)
        places = endpoint_of(address), endpoint_of(client.getsockname()), endpoint_of(server.getsockname())
        relay.meet(self, (*places, to), first[1])

    @property
    def state(self) -> str:
        """How the connection to the controller is."""
        if self._buried:
            return "half-open"
        return "connected" if self._connected else "connecting"

    def fail(self, problem: int) -> None:
        """Give up: the controller cannot be reached."""
        text = reason(OSError(problem, ""))
        self._relay.tell(f"{self.conversation.client}: no connection to {self._to} over TCP: {text}")
        self.close(True, "the controller cannot be reached")

    def send(self, up: bool, data: bytes) -> int:
        """Send what rules give; return when, 0 if not all of it went out yet."""
        if self._closed:
            return 0
        half = self._up if up else self._down
        left, sent = self._write(half, memoryview(data))
        if 0 < sent < len(data):
            self._relay.ring.put(up, self.number, 0, left, data[:sent])
        return left if sent == len(data) else 0

    def passed_on(self, up: bool) -> None:
        """Pass the end of a direction on, if it has ended; else read on what was not read meanwhile."""
        self._shut(self._up if up else self._down)
        self._want()

    def read_on(self) -> None:
        """Read what was not read while rules held too much."""
        self._want()

    def close(self, reset_both: bool, why: str) -> None:
        """Close both connections, after what rules still give out of what they held."""
        self._close(reset_both, why, why.encode())

    def _close(self, reset_both: bool, why: str, cause: bytes = b"") -> None:
        """Close; `cause` goes with the ends of those directions that were not ended by their sources."""
        if self._ending:
            return
        self._ending = True
        spoke = self._relay.let_go(self)
        self._closed = True
        for half in (self._up, self._down):
            if half.pending and not reset_both:
                self._send_last(half)
            self._close_sink(half, reset_both and not (spoke and half.up), cause)  # or that would be lost
        self._relay.part(self, why)

    def _close_sink(self, half: _Half, by_reset: bool, cause: bytes) -> None:
        """Close the socket that a direction leads to, unless it is broken and was closed before."""
        sock = half.sink
        if sock.fileno() < 0:
            return
        self._relay.unwatch(sock.fileno())
        if by_reset or not half.shut:
            self._note(Kind.RESET if by_reset else Kind.END, half, cause, left=time.time_ns())
        if by_reset:
            reset(sock)
        else:
            sock.close()

    def _note(self, how: Kind, half: _Half, cause: bytes = b"", *, came: int = 0, left: int = 0) -> None:
        """Tell how a direction has ended."""
        self._relay.note_undecided(self, half.up)
        self._relay.ring.must(how, self.number, cause, came, left=left, up=half.up)

    def _send_last(self, half: _Half) -> None:
        """Write what is pending, as far as it is taken at once."""
        left, sent, when = len(half.pending), 0, time.time_ns()
        with suppress(OSError):
            sent = half.sink.send(half.pending)
        if sent:
            self._relay.ring.put(half.up, self.number, 0, when, bytes(half.pending[:sent]))
        left -= sent
        if left:
            whose = "the controller" if half.up else "the client"
            self._relay.tell(f"{self.conversation.client}: {left} bytes were not taken by {whose} any more")

    def quiet(self, now: int) -> int | None:
        """Return the ns for which nothing has moved, if that is too long for a connection that is stuck."""
        quiet = now - self._moved
        if self._up.ended and self._is_answered:
            return quiet if quiet > ANSWERED_FOR else None
        is_stuck = (
            self._buried or self._up.ended or self._down.ended or self._up.pending or self._down.pending
        )
        return quiet if is_stuck and quiet > STUCK_FOR else None

    def sweep(self, now: int) -> None:
        """Give up a connection that is not made or has been half closed for too long; go on where rules held
        too much, or have lost what they held before an end.
        """
        if not self._connected and now - self.heard > CONNECT_WITHIN:
            self.fail(errno.ETIMEDOUT)
        elif not self._buried and self._is_left(now - self._moved):
            self._close(False, "half closed, and nothing more came")
        elif self._relay.policy is not None:
            for half in (self._up, self._down):
                if half.ended and not half.shut and not self._relay.holds(self, half.up):
                    self._shut(half)
            self._want()

    def _is_left(self, quiet: int) -> bool:
        """Return whether one side has ended and the other has been quiet for longer than any call takes."""
        if any(self._relay.holds(self, half.up) for half in (self._up, self._down)):
            return False
        if self._down.shut:
            return quiet > STUCK_FOR
        return self._up.shut and quiet > ANSWER_WITHIN

    def _client_happened(self, happened: int) -> None:
        self._handle(happened, self._client, self._up, self._down)

    def _server_happened(self, happened: int) -> None:
        if not self._connected:
            problem = self._server.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            if problem:
                self.fail(problem)
            elif happened & WRITE:
                self._connected = True
                first, came = self._first
                self._first = b"", 0
                if first:
                    self._take_in(self._up, first, came)
                self._want()
        else:
            self._handle(happened, self._server, self._down, self._up)

    def _handle(self, happened: int, sock: socket.socket, incoming: _Half, outgoing: _Half) -> None:
        """Do what can be done on one socket: read the half that begins there, write the other."""
        problem = sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) if happened & ERROR else 0
        if problem:
            self._break(incoming, problem)
            return
        if happened & WRITE and outgoing.pending:
            self._flush(outgoing)
        if happened & (READ | HANG_UP) and not self._closed:
            if self._reads(incoming):
                self._read(incoming)
            elif happened & HANG_UP:  # or it would be told again and again
                self._set(sock, None)
            else:
                self._want()

    def _read(self, half: _Half) -> None:
        relay = self._relay
        try:
            size = half.source.recv_into(relay.buffer)
        except BlockingIOError:
            return
        except OSError as error:
            self._break(half, error.errno or 0)
            return
        came = time.time_ns()
        self._moved = relay.now
        if half.up:
            self.heard = relay.now
        elif self._up.ended:
            self._is_answered = True
        if not size:
            self._note(Kind.END, half, came=came)
            self._finish(half)
        else:
            self._take_in(half, memoryview(relay.buffer)[:size], came)

    def _take_in(self, half: _Half, data: bytes | memoryview, came: int) -> None:
        """Do with bytes that came what the rules say, or pass them on."""
        relay = self._relay
        if relay.policy is None:
            self._pass_on(half, memoryview(data), came)
            return
        relay.rule(self, half.up, bytes(data), came)
        if relay.is_full(self):
            self._want()

    def _finish(self, half: _Half) -> None:
        """Take notice that the source of a direction says no more."""
        half.ended = True
        if self._relay.ends(self, half.up):
            self._shut(half)
        if self._relay.hides_end(self) and self._up.ended and self._down.ended:
            self._close(False, "ended by both sides, which did not hear of each other's end")
        self._want()

    def _pass_on(self, half: _Half, data: memoryview, came: int) -> None:
        ring = self._relay.ring
        left, sent = self._write(half, data)
        if sent == len(data):
            ring.put(half.up, self.number, came, left, data)
        else:
            ring.put(half.up, self.number, came, 0, data)
            if sent:
                ring.put(half.up, self.number, 0, left, data[:sent])

    def _write(self, half: _Half, data: memoryview) -> tuple[int, int]:
        """Write what the sink takes and keep the rest; return when, and how many bytes it took."""
        sent = 0
        left = time.time_ns()
        if not half.pending:
            try:
                sent = half.sink.send(data)
            except BlockingIOError:
                pass
            except OSError as error:
                self._break(self._down if half.up else self._up, error.errno or 0)
                return 0, 0
        self._relay.counts[Count.BYTES_UP if half.up else Count.BYTES_DOWN] += sent
        if sent < len(data):
            half.pending += data[sent:]
            self._want()
        return left, sent

    def _flush(self, half: _Half) -> None:
        """Write what is pending."""
        data = bytes(half.pending[:_AT_ONCE])
        half.pending, pending = bytearray(), half.pending
        left, sent = self._write(half, memoryview(data))
        if self._closed:
            return
        half.pending = pending
        del half.pending[:sent]
        if sent:
            self._moved = self._relay.now
            self._relay.ring.put(half.up, self.number, 0, left, data[:sent])
        self._shut(half)
        self._want()

    def _shut(self, half: _Half) -> None:
        """Pass the end of a direction on, once all before it is out; let go when both are over."""
        if half.pending or half.shut or not half.ended or self._closed:
            return
        half.shut = True
        self._note(Kind.END, half, left=time.time_ns())
        with suppress(OSError):
            half.sink.shutdown(socket.SHUT_WR)
        if self._up.shut and self._down.shut:
            self._close(False, "ended by both sides")

    def _break(self, half: _Half, problem: int) -> None:
        """Pass on that the source of a direction is broken, unless the other side is not to hear of it."""
        was_reset = problem in _RESETS
        if was_reset:
            self._note(Kind.RESET, half, came=time.time_ns())
        self._relay.unwatch(half.source.fileno())
        half.source.close()
        if self._relay.hides_end(self):
            self._buried = True
            self._finish(half)
            return
        who = "the client" if half.up else "the controller"
        why = f"{who}: {reason(OSError(problem, ''))}"
        self._close(True, why, b"" if was_reset else why.encode())

    def _reads(self, half: _Half) -> bool:
        """Tell whether more may be read: never while a peer does not take what there is."""
        policy = self._relay.policy
        if self._relay.is_full(self):
            return False
        most = 0 if policy is None else MOST_PENDING
        if half.up and policy is not None and len(self._down.pending) > most:
            return False  # what rules answer would pile up for a client that asks and does not listen
        return self._connected and not half.ended and len(half.pending) <= most

    def _want(self) -> None:
        """Tell the poller what is waited for now."""
        if self._closed:
            return
        for sock, incoming, outgoing in (
            (self._client, self._up, self._down),
            (self._server, self._down, self._up),
        ):
            self._set(sock, READ * self._reads(incoming) | WRITE * bool(outgoing.pending))

    def _set(self, sock: socket.socket, mask: int | None) -> None:
        descriptor = sock.fileno()
        if descriptor < 0:  # closed, and the other side does not know
            return
        known = self._masks[descriptor]
        if mask == known:
            return
        self._masks[descriptor] = mask
        if mask is None:
            self._relay.unwatch(descriptor)
        elif known is None:
            handler = self._client_happened if sock is self._client else self._server_happened
            self._relay.watch(descriptor, handler, mask)
        else:
            self._relay.change(descriptor, mask)
