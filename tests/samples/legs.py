"""Captures of one conversation at two places: both legs of a proxy, or a capture at either end."""

from __future__ import annotations

from bcapscope.protocol.codec.variant import VT, Variant
from tests.samples.calls import CLIENT, MS, SERVER, START, US, Datagrams, i4, r8s, reply, request, text
from tests.samples.files import Interface, Packet, pcap, pcapng
from tests.samples.wire import Host

PROXY_NEAR = Host(bytes.fromhex("0200c0a80005"), "192.168.0.5", 5008)
PROXY_FAR = Host(bytes.fromhex("0200c0a80005"), "192.168.0.5", 40001)

RETRY_NS = 8 * MS


class TwoPlaces:
    """A client that polls, and what is captured at its side and at the controller's side.

    Attributes:
        near, far: what is captured at either place.
        lost: "request" or "reply" by the number of the call whose first attempt is lost between the places.
    """

    def __init__(self, near: Datagrams, far: Datagrams, delay: int, note: str = "") -> None:
        self.near, self.far = near, far
        self.lost: dict[int, str] = {}
        self._delay = delay
        self._note = note
        self._serial = 0

    def poll(self, calls: int, first: int = START, period: int = 50 * MS) -> TwoPlaces:
        """Let the client make `calls` calls; the first opens a session."""
        for number in range(calls):
            self._call(number, first + number * period)
        return self

    def _call(self, number: int, time: int) -> None:
        lost = self.lost.get(number, "")
        first = self._attempt(time, 0, number, lost)
        if lost:
            self._attempt(time + RETRY_NS, first, number, "")

    def _attempt(self, time: int, reserved: int, number: int, lost: str) -> int:
        self._serial = serial = self._serial + 1
        asked = (
            request(serial, reserved, "Service_Start", text(""))
            if number == 0
            else request(serial, reserved, "Robot_Execute", i4(1), text("CurJnt"), Variant(VT.EMPTY, None))
        )
        answer = reply(serial, 0, *(() if number == 0 else (r8s(float(number), 2.0),)))
        self.near.up(time, asked, self._note if lost == "request" else "")
        if lost == "request":
            return serial
        self.far.up(time + self._delay, asked)
        answered = time + self._delay + MS
        self.far.down(answered, answer, self._note if lost == "reply" else "")
        if lost != "reply":
            self.near.down(answered + self._delay, answer)
        return serial

    def recording(self) -> bytes:
        """Return one file with both places."""
        return pcapng(_in_order([*self.near.packets, *self.far.packets]), [Interface("any")])

    def captures(self, clock: int = 0, drift: float = 0.0) -> tuple[bytes, bytes]:
        """Return a file of either place. The controller's clock is `clock` ns ahead and gains `drift`."""
        far = [packet._replace(time=_by_clock(packet.time, clock, drift)) for packet in self.far.packets]
        return pcap(_in_order(self.near.packets), nanoseconds=True), pcap(_in_order(far), nanoseconds=True)


def _in_order(packets: list[Packet]) -> list[Packet]:
    return sorted(packets, key=lambda packet: packet.time)


def _by_clock(time: int, clock: int, drift: float) -> int:
    return time + clock + round((time - START) * drift)


def both_legs(note: str = "drop: dropped") -> TwoPlaces:
    """Return the two legs of a proxy, which writes `note` beside the packets that it drops."""
    return TwoPlaces(Datagrams(CLIENT, PROXY_NEAR), Datagrams(PROXY_FAR, SERVER), 200 * US, note)


def both_ends(delay: int = 300 * US) -> TwoPlaces:
    """Return captures at the client and at the controller, with a one-way `delay` in ns."""
    return TwoPlaces(Datagrams(), Datagrams(), delay)
