"""TCP sessions of the proxy. A session forwards data, FINs and RSTs. If a receiver is slow, the session reads
less from the sender.
"""

from __future__ import annotations

import errno
import socket
import time
from contextlib import suppress
from dataclasses import dataclass, field

from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.proxy.poller import ERROR, HANG_UP, READ, WRITE
from bcapscope.proxy.relay import Relay, encode_note
from bcapscope.proxy.relay_session import ClientEndpoints, RelaySession
from bcapscope.proxy.ring_buffer import RelayCounter, RingRecordKind
from bcapscope.proxy.sockets import SocketAddress, endpoint_of, keep_alive
from bcapscope.traffic.observation import Endpoint, Transport
from bcapscope.transport.socket_link import close_with_reset

CONNECT_TIMEOUT_NS = 10_000_000_000
"""Maximum time in ns to connect to the controller."""

REPLY_TIMEOUT_NS = 200_000_000_000
"""Time in ns that a client may wait for a reply after it has ended its direction of the connection. A call
may take 180 s, the default of InvokeTimeout (orin_bcap C/src/bCAPServer/bcap_server.c).
"""

STUCK_AFTER_NS = 10_000_000_000
"""If only the controller has ended its stream, the session ends after this idle time in ns. If one direction
has ended or is blocked, a new client may replace the session's client after this idle time.
"""

ANSWERED_IDLE_NS = 1_000_000_000
"""If the client has sent a FIN, and the controller has sent bytes or a FIN after that, a new client may
replace the session's client after this idle time in ns.
"""

MAX_PENDING = 1 << 18
"""With rules, a session stops reading from a sender while more than this many bytes wait for the receiver.
Without rules, a session stops reading while any bytes wait.
"""

_AT_ONCE = 1 << 16

_RESETS = errno.ECONNRESET, errno.EPIPE


@dataclass(eq=False, slots=True)
class _HalfConnection:
    """One direction of a connection, from the socket `source` to the socket `sink`. The sink has not yet
    accepted the `pending` bytes. `mask` holds the watched events of the source; None if the source is not
    watched.
    """

    up: bool
    source: socket.socket
    sink: socket.socket
    pending: bytearray = field(default_factory=bytearray)
    source_ended: bool = False
    sink_shut: bool = False
    mask: int | None = 0


class TcpSession(RelaySession):
    def __init__(
        self,
        relay: Relay,
        to: Endpoint,
        ends: tuple[socket.socket, socket.socket],
        address: SocketAddress,
        first: tuple[bytes, int],
    ) -> None:
        """Register a client. `ends` are the socket toward the client, and the socket toward the controller,
        which is not connected yet. `first` are the client's first bytes, and their time of arrival in ns
        since 1970.
        """
        super().__init__(relay, Transport.TCP, address, to)
        client, server = ends
        for sock in ends:
            sock.setblocking(False)
            # macOS refuses socket options if the client has already closed the connection
            with suppress(OSError):
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                keep_alive(sock)
        self._last_activity = relay.now
        self._first: tuple[bytes, int] | None = first
        self._to = to
        self._up = _HalfConnection(True, client, server)
        self._down = _HalfConnection(False, server, client)
        self._connected = self._closed = self._is_half_open = self._is_ending = self._is_answered = False
        self._down.mask = WRITE
        relay.watch(client.fileno(), self._on_client_ready, 0)
        relay.watch(server.fileno(), self._on_controller_ready, WRITE)
        places = endpoint_of(address), endpoint_of(client.getsockname()), endpoint_of(server.getsockname())
        relay.add_client(self, ClientEndpoints(Transport.TCP, *places, to), first[1])

    @property
    def upstream_state(self) -> str:
        if self._is_half_open:
            return "half-open"
        return "connected" if self._connected else "connecting"

    def fail(self, problem: int) -> None:
        """End the session because the controller cannot be reached. `problem` is the error number."""
        client, reason = str(self.conversation.client), os_reason(OSError(problem, ""))
        self._relay.notify(
            Message("client.no-connection", client=client, controller=str(self._to), reason=reason)
        )
        self.close(True, Message("client.unreachable"))

    def send(self, up: bool, data: bytes) -> int:
        if self._closed:
            return 0
        half = self._up if up else self._down
        sent_at, sent = self._write(half, memoryview(data))
        if 0 < sent < len(data):
            self._relay.ring.write_record(up, self.number, 0, sent_at, data[:sent])
        return sent_at if sent == len(data) else 0

    def resume(self) -> None:
        for half in (self._up, self._down):
            if half.source_ended and not half.sink_shut and not self._relay.holds(self, half.up):
                self._shut_sink_when_flushed(half)
        self._update_masks()

    def close(self, reset_both: bool, why: Message) -> None:
        self._close(reset_both, why, encode_note(why))

    def _close(self, reset_both: bool, why: Message, cause: bytes = b"") -> None:
        """Close both connections. Record `cause` as the reason for each direction that was still open."""
        if self._is_ending:
            return
        self._is_ending = True
        released = self._relay.release_held(self)
        self._closed = True
        for half in (self._up, self._down):
            if half.pending and not reset_both:
                self._send_last(half)
            # After sending held requests, close without a reset: a reset would discard these requests.
            self._close_sink(half, reset_both and not (released and half.up), cause)
        self._relay.remove_client(self, why)

    def _close_sink(self, half: _HalfConnection, by_reset: bool, cause: bytes) -> None:
        sock = half.sink
        if sock.fileno() < 0:
            return
        self._relay.unwatch(sock.fileno())
        if by_reset or not half.sink_shut:
            self._record_end(
                RingRecordKind.RESET if by_reset else RingRecordKind.END, half, cause, sent_at=time.time_ns()
            )
        if by_reset:
            close_with_reset(sock)
        else:
            sock.close()

    def _record_end(
        self,
        how: RingRecordKind,
        half: _HalfConnection,
        cause: bytes = b"",
        *,
        received_at: int = 0,
        sent_at: int = 0,
    ) -> None:
        self._relay.record_undecided(self, half.up)
        self._relay.ring.write_required(how, self.number, cause, received_at, sent_at=sent_at, up=half.up)

    def _send_last(self, half: _HalfConnection) -> None:
        """Write as many pending bytes as the system accepts. Report how many bytes are lost."""
        rest, sent, when = len(half.pending), 0, time.time_ns()
        with suppress(OSError):
            sent = half.sink.send(half.pending)
        if sent:
            self._relay.ring.write_record(half.up, self.number, 0, when, bytes(half.pending[:sent]))
        rest -= sent
        if rest:
            case = "client.lost-at-controller" if half.up else "client.lost-at-client"
            self._relay.notify(Message(case, client=str(self.conversation.client), size=rest))

    def evictable_idle_ns(self, now: int) -> int | None:
        quiet = now - self._last_activity
        if self._up.source_ended and self._is_answered:
            return quiet if quiet > ANSWERED_IDLE_NS else None
        is_stuck = (
            self._is_half_open
            or self._up.source_ended
            or self._down.source_ended
            or self._up.pending
            or self._down.pending
        )
        return quiet if is_stuck and quiet > STUCK_AFTER_NS else None

    def sweep(self, now: int) -> None:
        """End a session that cannot connect or stays half closed too long; otherwise `resume` it."""
        if not self._connected and now - self.last_heard > CONNECT_TIMEOUT_NS:
            self.fail(errno.ETIMEDOUT)
        elif not self._is_half_open and self._is_expired(now - self._last_activity):
            self._close(False, Message("client.half-closed"))
        elif self._relay.policy is not None:
            self.resume()

    def _is_expired(self, quiet: int) -> bool:
        if any(self._relay.holds(self, half.up) for half in (self._up, self._down)):
            return False
        if self._down.sink_shut:
            return quiet > STUCK_AFTER_NS
        return self._up.sink_shut and quiet > REPLY_TIMEOUT_NS

    def _on_client_ready(self, happened: int) -> None:
        self._handle(happened, self._up, self._down)

    def _on_controller_ready(self, happened: int) -> None:
        if not self._connected:
            problem = self._down.source.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            if problem:
                self.fail(problem)
            elif happened & WRITE:
                self._connected = True
                first, self._first = self._first, None
                if first is not None and first[0]:
                    self._on_bytes(self._up, *first)
                self._update_masks()
        else:
            self._handle(happened, self._down, self._up)

    def _handle(self, happened: int, incoming: _HalfConnection, outgoing: _HalfConnection) -> None:
        """Handle events of the socket that is the source of `incoming` and the sink of `outgoing`."""
        sock = incoming.source
        problem = sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) if happened & ERROR else 0
        if problem:
            self._on_source_broken(incoming, problem)
            return
        if outgoing.pending:
            self._flush(outgoing)
        if happened & (READ | HANG_UP) and not self._closed:
            if self._may_read(incoming):
                self._read(incoming)
            elif happened & HANG_UP:  # ignore the socket: the poller would report the hang-up again and again
                self._set_mask(incoming, None)
            else:
                self._update_masks()

    def _read(self, half: _HalfConnection) -> None:
        relay = self._relay
        try:
            size = half.source.recv_into(relay.buffer)
        except BlockingIOError:
            return
        except OSError as error:
            self._on_source_broken(half, error.errno or 0)
            return
        received_at = time.time_ns()
        self._last_activity = relay.now
        if half.up:
            self.last_heard = relay.now
        elif self._up.source_ended:
            self._is_answered = True
        if not size:
            self._record_end(RingRecordKind.END, half, received_at=received_at)
            self._on_source_end(half)
        else:
            self._on_bytes(half, memoryview(relay.buffer)[:size], received_at)

    def _on_bytes(self, half: _HalfConnection, data: bytes | memoryview, received_at: int) -> None:
        relay = self._relay
        if relay.policy is None:
            self._forward_bytes(half, memoryview(data), received_at)
            return
        relay.apply_rules(self, half.up, bytes(data), received_at)

    def _on_source_end(self, half: _HalfConnection) -> None:
        half.source_ended = True
        if self._relay.on_stream_end(self, half.up):
            self._shut_sink_when_flushed(half)
        if self._relay.hides_end(self) and self._up.source_ended and self._down.source_ended:
            self._close(False, Message("client.ended-unheard"))

    def _forward_bytes(self, half: _HalfConnection, data: memoryview, received_at: int) -> None:
        ring = self._relay.ring
        sent_at, sent = self._write(half, data)
        if sent == len(data):
            ring.write_record(half.up, self.number, received_at, sent_at, data)
        else:
            ring.write_record(half.up, self.number, received_at, 0, data)
            if sent:
                ring.write_record(half.up, self.number, 0, sent_at, data[:sent])

    def _write(self, half: _HalfConnection, data: memoryview) -> tuple[int, int]:
        """Write as many bytes as the sink accepts, and keep the remaining bytes as pending. Return the time
        of writing in ns since 1970, and the number of written bytes.
        """
        sent = 0
        sent_at = time.time_ns()
        if not half.pending:
            try:
                sent = half.sink.send(data)
            except BlockingIOError:
                pass
            except OSError as error:
                self._on_source_broken(self._down if half.up else self._up, error.errno or 0)
                return 0, 0
        self._relay.counts[RelayCounter.BYTES_UP if half.up else RelayCounter.BYTES_DOWN] += sent
        if sent < len(data):
            half.pending += data[sent:]
            self._update_masks()
        return sent_at, sent

    def _flush(self, half: _HalfConnection) -> None:
        data = bytes(half.pending[:_AT_ONCE])
        half.pending, pending = bytearray(), half.pending
        sent_at, sent = self._write(half, memoryview(data))
        if self._closed:
            return
        half.pending = pending
        del half.pending[:sent]
        if sent:
            self._last_activity = self._relay.now
            self._relay.ring.write_record(half.up, self.number, 0, sent_at, data[:sent])
        self._shut_sink_when_flushed(half)
        self._update_masks()

    def _shut_sink_when_flushed(self, half: _HalfConnection) -> None:
        """Forward a direction's FIN after its last bytes. After both FINs, close the session."""
        if half.pending or half.sink_shut or not half.source_ended or self._closed:
            return
        half.sink_shut = True
        self._record_end(RingRecordKind.END, half, sent_at=time.time_ns())
        with suppress(OSError):
            half.sink.shutdown(socket.SHUT_WR)
        if self._up.sink_shut and self._down.sink_shut:
            self._close(False, Message("client.ended"))

    def _on_source_broken(self, half: _HalfConnection, problem: int) -> None:
        """Close the socket `half.source`, which reported an error. Then end the session, unless a half-open
        fault hides the error: in this case, the connection to the other end stays open.
        """
        was_reset = problem in _RESETS
        if was_reset:
            self._record_end(RingRecordKind.RESET, half, received_at=time.time_ns())
        self._relay.unwatch(half.source.fileno())
        half.source.close()
        if self._relay.hides_end(self):
            self._is_half_open = True
            self._on_source_end(half)
            return
        case = "client.broken-by-client" if half.up else "client.broken-by-controller"
        why = Message(case, reason=os_reason(OSError(problem, "")))
        self._close(True, why, b"" if was_reset else encode_note(why))

    def _may_read(self, half: _HalfConnection) -> bool:
        """Return whether the session may read more bytes of a direction. The session must not read if the
        proxy holds too much data, or if the receiver is slow.
        """
        policy = self._relay.policy
        if self._relay.pauses_reading(self):
            return False
        if policy is None:
            is_full = bool(half.pending)
        else:
            # If the client reads no replies, the proxy must not answer more requests.
            waiting = (half, self._down) if half.up else (half,)
            is_full = any(len(each.pending) > MAX_PENDING for each in waiting)
        return self._connected and not half.source_ended and not is_full

    def _update_masks(self) -> None:
        if self._closed:
            return
        for incoming, outgoing in ((self._up, self._down), (self._down, self._up)):
            self._set_mask(incoming, READ * self._may_read(incoming) | WRITE * bool(outgoing.pending))

    def _set_mask(self, half: _HalfConnection, mask: int | None) -> None:
        descriptor = half.source.fileno()
        if descriptor < 0 or mask == half.mask:  # a session may close one socket, but keep the other open
            return
        known, half.mask = half.mask, mask
        if mask is None:
            self._relay.unwatch(descriptor)
        elif known is None:
            handler = self._on_client_ready if half.up else self._on_controller_ready
            self._relay.watch(descriptor, handler, mask)
        else:
            self._relay.change(descriptor, mask)
