"""Slave-mode traffic of any length, whose every chain is known beforehand.

One client drives one robot over UDP: a session is opened, slave mode 0x202 entered, then a set point
of eight doubles goes out every 8 ms and is answered with the pose of that moment. Every hundredth set
point, as chance has it, is sent again after 2 ms, either since the request was lost or since its reply was
late. Serials and the reserved field follow "DENSO Wave 2009, How to use the Slave mode": each retry has the
next serial and carries the first one in reserved, and replies repeat both.

Nothing here uses the package: the bytes are an oracle for it. The same length always gives the same bytes.
Run as ``python -m tests.bench.traffic 1000000 slave.pcap``.
"""

from __future__ import annotations

import math
import random
import struct
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import NamedTuple

CLIENT = (bytes((10, 0, 0, 2)), 50001)
SERVER = (bytes((10, 0, 0, 1)), 5007)
START_US = 1_700_000_000_000_000
PACE_US = 8_000
RETRY_US = 2_000
RETRY_RATE = 0.01
SLAVE_MODE = 0x202
ROBOT = 2

ROBOT_EXECUTE = 64
I4, R8, BSTR, ARRAY = 3, 5, 8, 0x2000


class Truth(NamedTuple):
    """What was written, for those who count the same things in the capture.

    Attributes:
        frames: all requests, retries and replies.
        calls: different questions asked, the session's opening included.
        retries: requests sent again.
        late_replies: replies to a try that the client had already given up.
        unanswered: 1 where the wanted length cut the last call short, else 0.
    """

    frames: int
    calls: int
    retries: int
    late_replies: int
    unanswered: int


def _argument(vt: int, count: int, data: bytes) -> bytes:
    return struct.pack("<IHI", 6 + len(data), vt, count) + data


def _i4(*values: int, vt: int = I4) -> bytes:
    return _argument(vt, len(values), struct.pack(f"<{len(values)}i", *values))


def _bstr(text: str) -> bytes:
    data = text.encode("utf-16-le")
    return _argument(BSTR, 1, struct.pack("<I", len(data)) + data)


def _frame(serial: int, reserved: int, code: int, *args: bytes) -> bytes:
    body = b"".join(args)
    return struct.pack("<BIHHiH", 1, 16 + len(body), serial, reserved, code, len(args)) + body + b"\x04"


def _ip_header(src: bytes, dst: bytes, payload: int) -> bytes:
    head = struct.pack(">BBHHHBBH", 0x45, 0, 28 + payload, 0, 0x4000, 64, 17, 0) + src + dst
    total = sum(struct.unpack(">10H", head))
    total = (total & 0xFFFF) + (total >> 16)
    return head[:10] + struct.pack(">H", ~((total & 0xFFFF) + (total >> 16)) & 0xFFFF) + head[12:]


def _headers(to_server: bool, payload: int) -> bytes:
    """Ethernet, IPv4 and UDP in front of `payload` bytes; UDP checksum 0, that is, not computed."""
    (src, sport), (dst, dport) = (CLIENT, SERVER) if to_server else (SERVER, CLIENT)
    ethernet = b"\x02\x00" + dst + b"\x02\x00" + src + b"\x08\x00"
    return ethernet + _ip_header(src, dst, payload) + struct.pack(">HHHH", sport, dport, 8 + payload, 0)


def _record(time_us: int, to_server: bool, frame: bytes) -> bytes:
    packet = _headers(to_server, len(frame)) + frame
    return struct.pack("<IIII", *divmod(time_us, 1_000_000), len(packet), len(packet)) + packet


class _Template:
    """A frame that ends with eight doubles, of which only time, serial, reserved and doubles change."""

    def __init__(self, to_server: bool, code: int, *args: bytes) -> None:
        sample = _frame(0, 0, code, *args, _argument(R8 | ARRAY, 8, bytes(64)))
        self._head = _headers(to_server, len(sample)) + sample[:5]
        self._middle = sample[9:-65]
        self._size = len(self._head) - 5 + len(sample)
        self._struct = struct.Struct(f"<IIII{len(self._head)}sHH{len(self._middle)}s8dB")

    def record(self, time_us: int, serial: int, reserved: int, doubles: list[float]) -> bytes:
        size = self._size
        seconds, micros = divmod(time_us, 1_000_000)
        return self._struct.pack(
            seconds, micros, size, size, self._head, serial, reserved, self._middle, *doubles, 4
        )


_SET_POINT = _Template(True, ROBOT_EXECUTE, _i4(ROBOT), _bstr("slvMove"))
_POSE = _Template(False, 0)
_EMPTY = _argument(0, 1, b"")
# centre and amplitude in degrees, angular step in radians per set point, of each axis
_AXES = tuple((10.0 * n - 35.0, 40.0 - 3.0 * n, 0.004 + 0.0007 * n) for n in range(8))


# function id, request's arguments and reply's arguments of each call that opens the session
_OPENING: tuple[tuple[int, tuple[bytes, ...], tuple[bytes, ...]], ...] = (
    (1, (_bstr(",WDT=400"),), ()),
    (3, tuple(map(_bstr, ("bench", "CaoProv.DENSO.VRC", "localhost", ""))), (_i4(1),)),
    (7, (_i4(1), _bstr("Arm"), _bstr("")), (_i4(ROBOT),)),
    (ROBOT_EXECUTE, (_i4(ROBOT), _bstr("TakeArm"), _i4(0, 0, vt=I4 | ARRAY)), (_EMPTY,)),
    (ROBOT_EXECUTE, (_i4(ROBOT), _bstr("slvChangeMode"), _i4(SLAVE_MODE)), (_EMPTY,)),
)


class Session:
    """The client's serial, the clock and the counters of one session; `records` is its traffic."""

    def __init__(self) -> None:
        self._random = random.Random(5007).random
        self._serial = 0
        self._time = START_US
        self.calls = self.answered = self.retries = self.late_replies = 0

    def _next_serial(self) -> int:
        self._serial = self._serial % 0xFFFF + 1
        return self._serial

    def _open(self) -> Iterator[bytes]:
        for function, request, reply in _OPENING:
            serial = self._next_serial()
            self.calls += 1
            yield _record(self._time, True, _frame(serial, 0, function, *request))
            self.answered += 1
            yield _record(self._time + 1_500, False, _frame(serial, 0, 0, *reply))
            self._time += 20_000

    def _retried(self, serial: int, goal: list[float], pose: list[float]) -> Iterator[bytes]:
        """What follows a request that is still without reply after 2 ms."""
        retry, sent = self._next_serial(), self._time + RETRY_US
        self.retries += 1
        yield _SET_POINT.record(sent, retry, serial, goal)
        if self._random() < 0.5:
            self.late_replies += 1
            yield _POSE.record(sent + 300, serial, 0, pose)
        self.answered += 1
        yield _POSE.record(sent + 900, retry, serial, pose)

    def records(self) -> Iterator[bytes]:
        """Yield pcap records without end, in the order of their times."""
        yield from self._open()
        chance, sin, step = self._random, math.sin, 0
        while True:
            goal = [centre + size * sin(rate * step) + 1e-3 * chance() for centre, size, rate in _AXES]
            pose = [degrees - 2e-2 * chance() for degrees in goal]
            serial = self._next_serial()
            self.calls += 1
            yield _SET_POINT.record(self._time, serial, 0, goal)
            if chance() < RETRY_RATE:
                yield from self._retried(serial, goal, pose)
            else:
                self.answered += 1
                yield _POSE.record(self._time + 600 + int(800 * chance()), serial, 0, pose)
            self._time += PACE_US
            step += 1


def write(path: Path, frames: int) -> Truth:
    """Write a little-endian microsecond pcap of `frames` packets to `path` and say what is in it."""
    session = Session()
    records = session.records()
    left = frames
    with path.open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 262144, 1))
        while left:
            batch = list(islice(records, min(left, 8192)))
            file.write(b"".join(batch))
            left -= len(batch)
    unanswered = session.calls - session.answered
    return Truth(frames, session.calls, session.retries, session.late_replies, unanswered)


if __name__ == "__main__":
    print(write(Path(sys.argv[2]), int(sys.argv[1])))
