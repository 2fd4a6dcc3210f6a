"""TCP: frames cut, glued, sent twice and out of order; and a capture that missed some of it."""

from __future__ import annotations

from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from tests.samples.calls import (
    CLIENT,
    MS,
    SECOND,
    SERVER,
    START,
    US,
    i4,
    mixed,
    r8s,
    reply,
    request,
    text,
)
from tests.samples.files import Packet, pcap
from tests.samples.wire import TCP_ACK, TCP_FIN, TCP_PSH, TCP_RST, TCP_SYN, Host, ethernet, tcp

_CONTROLLER, _ROBOT, _FIRST_VARIABLE, _SECOND_VARIABLE = 1, 2, 3, 4
_LONG_REPLY_CUTS = (210, 420)


class Connection:
    """A TCP connection as a card between the two sees it."""

    def __init__(
        self,
        client: Host = CLIENT,
        server: Host = SERVER,
        first: tuple[int, int] = (1000, 5000),
        vlans: tuple[int, ...] = (),
    ) -> None:
        """Begin with the sequence numbers `first` of client and server."""
        self.packets: list[Packet] = []
        self._ends = (client, server)
        self._next = list(first)
        self._vlans = vlans

    def open(self, time: int) -> None:
        """Shake hands."""
        self._emit(time, 0, TCP_SYN, self._next[0])
        self._next[0] += 1
        self._emit(time + 180 * US, 1, TCP_SYN | TCP_ACK, self._next[1])
        self._next[1] += 1
        self._emit(time + 230 * US, 0, TCP_ACK, self._next[0])

    def up(self, time: int, data: bytes) -> None:
        """Send from the client."""
        self._send(time, 0, data)

    def down(self, time: int, data: bytes) -> None:
        """Send from the controller."""
        self._send(time, 1, data)

    def down_swapped(self, time: int, first: bytes, second: bytes) -> None:
        """Send two segments from the controller that arrive in the wrong order."""
        at = self._next[1]
        self._emit(time, 1, TCP_PSH | TCP_ACK, at + len(first), second)
        self._emit(time + 60 * US, 1, TCP_PSH | TCP_ACK, at, first)
        self._next[1] += len(first) + len(second)

    def down_again(self, time: int, data: bytes, before: int = 0) -> None:
        """Send `data` again, which the controller sent `before` bytes ahead of its last one."""
        self._emit(time, 1, TCP_PSH | TCP_ACK, self._next[1] - before - len(data), data)

    def down_unseen(self, size: int) -> None:
        """Send so many bytes from the controller that the capture misses."""
        self._next[1] += size

    def close(self, time: int) -> None:
        """End both directions."""
        self._emit(time, 0, TCP_FIN | TCP_ACK, self._next[0])
        self._next[0] += 1
        self._emit(time + 200 * US, 1, TCP_FIN | TCP_ACK, self._next[1])
        self._next[1] += 1
        self._emit(time + 250 * US, 0, TCP_ACK, self._next[0])

    def reset(self, time: int) -> None:
        """Break the connection off from the controller."""
        self._emit(time, 1, TCP_RST | TCP_ACK, self._next[1])

    def _send(self, time: int, side: int, data: bytes) -> None:
        self._emit(time, side, TCP_PSH | TCP_ACK, self._next[side], data)
        self._next[side] += len(data)

    def _emit(self, time: int, side: int, flags: int, seq: int, data: bytes = b"") -> None:
        src, dst = self._ends[side], self._ends[1 - side]
        ack = 0 if flags == TCP_SYN else self._next[1 - side]
        ident = len(self.packets) + 1
        segment = tcp(src, dst, seq=seq, ack=ack, flags=flags, payload=data, ident=ident)
        self.packets.append(Packet(time, ethernet(src, dst, segment, self._vlans)))


def segments() -> bytes:
    """Return a whole session in which TCP cuts and glues the frames; nothing is missing."""
    connection = Connection(first=(0xFFFFFF00, 0xFFFFFE80))
    connection.open(START)
    connection.up(START + MS, request(1, 0, "Service_Start", text("")))
    connection.down(START + 2 * MS, reply(1, 0))
    names = map(text, ("watch", "CaoProv.DENSO.VRC", "localhost", ""))
    connection.up(START + 5 * MS, request(2, 0, "Controller_Connect", *names))
    connection.down(START + 22 * MS, reply(2, 0, i4(_CONTROLLER)))
    robot = request(3, 0, "Controller_GetRobot", i4(_CONTROLLER), text("Arm"), text(""))
    connection.up(START + 25 * MS, robot[:5])
    connection.up(START + 65 * MS, robot[5:])
    connection.down(START + 66 * MS, reply(3, 0, i4(_ROBOT)))
    _glued(connection, START + 70 * MS)
    _in_three(connection, START + 100 * MS)
    ask = request(7, 0, "Variable_GetValue", i4(_FIRST_VARIABLE))
    answer = reply(7, 0, r8s(12.5, -40.0, 110.25, 0.0, 65.0, 0.0, 0.0, 0.0))
    connection.up(START + 200 * MS, ask)
    connection.down_swapped(START + 201 * MS, answer[:33], answer[33:])
    _release(connection, START + 300 * MS)
    connection.close(START + 320 * MS)
    return pcap(connection.packets, nanoseconds=True)


def gap() -> bytes:
    """Return what a capture holds that begins in the middle of a frame and loses a segment later."""
    connection = Connection(first=(71_000, 92_000))
    connection.down(START, reply(41, 0, _record(1))[-30:])
    connection.up(START + 5 * MS, _ask_record(42, 2))
    connection.down(START + 7 * MS, reply(42, 0, _record(2)))
    answer = reply(43, 0, _record(3))
    connection.up(START + 10 * MS, _ask_record(43, 3))
    connection.down(START + 12 * MS, answer[:250])
    connection.down_unseen(len(answer) - 250 - 100)
    connection.down(START + 13 * MS, answer[-100:])
    connection.up(START + 15 * MS, _ask_record(44, 4))
    connection.down(START + 17 * MS, reply(44, 0, _record(4)))
    connection.up(START + 20 * MS, _ask_record(45, 5))
    connection.down(START + 22 * MS, reply(45, 0, _record(5))[:16])
    connection.reset(START + 2 * SECOND)
    return pcap(connection.packets)


def _glued(connection: Connection, at: int) -> None:
    """Ask for two variables in one segment; both answers come in one as well."""
    names = ((4, "@CURRENT_ANGLE"), (5, "@SERVO_ON"))
    asks = (request(n, 0, "Robot_GetVariable", i4(_ROBOT), text(name), text("")) for n, name in names)
    connection.up(at, b"".join(asks))
    connection.down(at + 3 * MS, reply(4, 0, i4(_FIRST_VARIABLE)) + reply(5, 0, i4(_SECOND_VARIABLE)))


def _in_three(connection: Connection, at: int) -> None:
    """Answer in three segments, the second of which comes twice."""
    answer = reply(6, 0, _record(0))
    one, two = _LONG_REPLY_CUTS
    connection.up(at, _ask_record(6, 0))
    connection.down(at + 2 * MS, answer[:one])
    connection.down(at + 2 * MS + 40 * US, answer[one:two])
    connection.down_again(at + 5 * MS, answer[one:two])
    connection.down(at + 5 * MS + 90 * US, answer[two:])


def _release(connection: Connection, at: int) -> None:
    calls = (
        ("Variable_Release", (i4(_SECOND_VARIABLE),)),
        ("Variable_Release", (i4(_FIRST_VARIABLE),)),
        ("Robot_Release", (i4(_ROBOT),)),
        ("Controller_Disconnect", (i4(_CONTROLLER),)),
        ("Service_Stop", ()),
    )
    for serial, (function, arguments) in enumerate(calls, 8):
        connection.up(at, request(serial, 0, function, *arguments))
        connection.down(at + MS, reply(serial, 0))
        at += 3 * MS


def _ask_record(serial: int, index: int) -> bytes:
    return request(serial, 0, "Robot_Execute", i4(_ROBOT), text("GetLogRecord"), i4(index))


def _record(index: int) -> Variant:
    """Make a record of the control log: 39 values, four for each axis and seven for the program."""
    values = []
    for axis in range(8):
        aim = 10.0 * axis + 0.25 * index if axis < 6 else 0.0
        values += [aim, aim - 0.0625, 12.5 - axis if axis < 6 else 0.0, 31.0 if axis < 6 else 0.0]
    axes = tuple(Variant(VT.R8, value) for value in values)
    program = (EMPTY, i4(0), text("PRO1"), i4(17 + index), i4(812_000 + 8 * index), i4(0), i4(0))
    return mixed(*axes, *program)
