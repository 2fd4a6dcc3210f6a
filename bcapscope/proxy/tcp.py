"""Streams: half-close, reset and back-pressure pass through."""

from __future__ import annotations

import errno
import socket
import time
from contextlib import suppress

from bcapscope.proxy.poller import ERROR, HANG_UP, READ, WRITE
from bcapscope.proxy.relay import Relay, conversation
from bcapscope.proxy.ring import Count, Kind
from bcapscope.proxy.sockets import SocketAddress, endpoint_of, listen_on, reason, resolve
from bcapscope.proxy.spec import Listener
from bcapscope.traffic.observation import Transport
from bcapscope.transport.tcp import reset

CONNECT_WITHIN = 10_000_000_000
"""ns."""

MOST_PENDING = 1 << 18
"""Bytes that rules may hand over for a peer that does not read, before nothing more is read for it. Without
rules it is what one read gave."""

_AT_ONCE = 1 << 16

_RESETS = errno.ECONNRESET, errno.EPIPE
"""What the system says of a connection that its peer has reset."""


class TcpPort:
    """A socket that clients connect to.

    Attributes:
        relay: whose it is.
        address: where it listens.
        controller: address family and address of the controller.
        to: the same as the user says it.
    """

    def __init__(self, relay: Relay, listener: Listener) -> None:
        """Listen.

        Raises:
            ListenError: that cannot be done.
        """
        self.relay = relay
        self.controller = resolve(listener.to, Transport.TCP)
        self.to = endpoint_of(self.controller[1])
        self._socket = listen_on(listener.listen, Transport.TCP)
        self.address = endpoint_of(self._socket.getsockname())
        self._listener = listener
        self._told = False

    def open(self) -> None:
        """Begin to take clients."""
        self.relay.watch(self._socket.fileno(), self._acceptable)

    def close(self) -> None:
        """Take no more clients."""
        self.relay.unwatch(self._socket.fileno())
        self._socket.close()

    def release(self) -> None:
        """Do nothing: the socket is closed by now."""

    def sweep(self, now: int) -> None:
        """Do nothing."""

    def _acceptable(self, _: int) -> None:
        relay = self.relay
        try:
            client, address = self._socket.accept()
        except (BlockingIOError, ConnectionError):
            return
        except OSError as error:  # no more file descriptors, say
            self._pause(error)
            return
        why = self._refusal(address[0])
        if why:
            relay.counts[Count.DENIED] += 1
            relay.tell(f"{endpoint_of(address)} {why}; its connection is closed")
            reset(client)
            return
        try:
            server = socket.socket(self.controller[0], socket.SOCK_STREAM)
        except OSError as error:  # that was the last one
            reset(client)
            self._pause(error)
            return
        self._told = False
        server.setblocking(False)
        problem = server.connect_ex(self.controller[1])
        session = TcpSession(self, client, server, address)
        if problem not in (0, errno.EINPROGRESS, errno.EWOULDBLOCK):
            session.fail(problem)

    def _pause(self, error: OSError) -> None:
        """Take no more clients for a while; that is told once, until one can be taken again."""
        if not self._told:
            self._told = True
            self.relay.tell(f"no client can be taken on {self.address} TCP: {reason(error)}")
        self.relay.pause(self._socket.fileno())

    def _refusal(self, host: str) -> str:
        if not self._listener.allows(host):
            return "is not allowed"
        return "" if self.relay.has_room() else "is one client too many"


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
        heard: `Relay.now` when the client was last heard.
    """

    def __init__(
        self, port: TcpPort, client: socket.socket, server: socket.socket, address: SocketAddress
    ) -> None:
        """Take in a client that has connected; `server` is on its way."""
        relay = port.relay
        for sock in (client, server):
            sock.setblocking(False)
            with suppress(OSError):  # on macOS a client that has gone by now has no options any more
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self.number = relay.next_number()
        self.conversation = conversation(endpoint_of(address), port.to, Transport.TCP)
        self.heard = relay.now
        self._relay = relay
        self._port = port
        self._client = client
        self._server = server
        self._up = _Half(True, client, server)
        self._down = _Half(False, server, client)
        self._connected = self._closed = self._buried = self._ending = False
        self._masks: dict[int, int | None] = {client.fileno(): 0, server.fileno(): WRITE}
        relay.watch(client.fileno(), self._client_happened, 0)
        relay.watch(server.fileno(), self._server_happened, WRITE)
        ends = endpoint_of(address), endpoint_of(client.getsockname()), endpoint_of(server.getsockname())
        relay.meet(self, (*ends, port.to))

    @property
    def state(self) -> str:
        """How the connection to the controller is."""
        if self._buried:
            return "half-open"
        return "connected" if self._connected else "connecting"

    def fail(self, problem: int) -> None:
        """Give up: the controller cannot be reached."""
        to = self._port.to
        text = reason(OSError(problem, ""))
        self._relay.tell(f"{self.conversation.client}: no connection to {to} over TCP: {text}")
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

    def sweep(self, now: int) -> None:
        """Give up a connection that is not made; go on where rules held too much, or have lost what they held
        before an end.
        """
        if not self._connected and now - self.heard > CONNECT_WITHIN:
            self.fail(errno.ETIMEDOUT)
        elif self._relay.policy is not None:
            for half in (self._up, self._down):
                if half.ended and not half.shut and not self._relay.holds(self, half.up):
                    self._shut(half)
            self._want()

    def _client_happened(self, happened: int) -> None:
        self._handle(happened, self._client, self._up, self._down)

    def _server_happened(self, happened: int) -> None:
        if not self._connected:
            problem = self._server.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            if problem:
                self.fail(problem)
            elif happened & WRITE:
                self._connected = True
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
        if half.up:
            self.heard = relay.now
        if not size:
            self._note(Kind.END, half, came=came)
            self._finish(half)
        elif relay.policy is not None:
            relay.rule(self, half.up, bytes(relay.buffer[:size]), came)
            if relay.policy.is_full(self.number):
                self._want()
        else:
            self._pass_on(half, memoryview(relay.buffer)[:size], came)

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
        if policy is not None and policy.is_full(self.number):
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
