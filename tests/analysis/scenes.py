"""Small captures, each with one thing that is wrong, or almost wrong.

Each is made as the bytes of a pcap file and read by the real reader, so that rules are tested end to end.
Moments are milliseconds from the beginning.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from typing import NamedTuple, TypeAlias

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.finding import Finding, TrafficTotals
from bcapscope.capture.capture_file import CaptureFile
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.protocol.codec.variant import EMPTY, Variant
from bcapscope.traffic.joining.joiner import Joiner
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.pipeline import Pipeline
from tests.samples.calls import MS, SERVER, START, Datagrams, i4, i4s, r8s, reply, request, text
from tests.samples.files import Interface, Packet, pcap, pcapng
from tests.samples.tcp import Connection
from tests.samples.wire import Host

CONTROLLER, ROBOT = i4(1), i4(2)
HOME = (0.0, 10.0, 80.0, 0.0, 90.0, 0.0, 0.0, 0.0)


class Talker:
    """A client and its controller; a call is answered after a millisecond unless told otherwise."""

    def __init__(self, client: Host, server: Host, tcp: bool) -> None:
        kind = Connection if tcp else Datagrams
        self.network: Connection | Datagrams = kind(client, server)
        self.serial = 0

    def ask(
        self,
        ms: float,
        function: str,
        *arguments: Variant,
        serial: int | None = None,
        reserved: int = 0,
    ) -> int:
        """Send a request; return its serial."""
        self.serial = self.serial + 1 if serial is None else serial
        self.network.up(_time(ms), request(self.serial, reserved, function, *arguments))
        return self.serial

    def answer(self, ms: float, serial: int, *results: Variant, code: int = 0, reserved: int = 0) -> None:
        """Send a reply."""
        self.network.down(_time(ms), reply(serial, reserved, *results, hresult=code))

    def call(
        self,
        ms: float,
        function: str,
        *arguments: Variant,
        result: Variant | None = None,
        code: int = 0,
        takes: float = 1.0,
        serial: int | None = None,
    ) -> None:
        """Ask and answer."""
        results = () if result is None else (result,)
        number = self.ask(ms, function, *arguments, serial=serial)
        self.answer(ms + takes, number, *results, code=code)

    def execute(
        self,
        ms: float,
        command: str,
        parameter: Variant = EMPTY,
        result: Variant = EMPTY,
        *,
        code: int = 0,
        takes: float = 1.0,
    ) -> None:
        """Ask for a command of the robot and answer."""
        arguments = (ROBOT, text(command), parameter)
        self.call(ms, "Robot_Execute", *arguments, result=result, code=code, takes=takes)

    def control(self, ms: float, command: str, parameter: Variant = EMPTY, code: int = 0) -> None:
        """Ask for a command of the controller and answer."""
        self.call(ms, "Controller_Execute", CONTROLLER, text(command), parameter, result=EMPTY, code=code)

    def open(self, ms: float = 0, option: str = ",WDT=400", provider: str = "CaoProv.DENSO.VRC") -> None:
        """Start a session and get the robot, with all that a careful client does; takes 40 ms."""
        names = map(text, ("", provider, "localhost", ""))
        self.call(ms, "Service_Start", text(option))
        self.call(ms + 5, "Controller_Connect", *names, result=CONTROLLER)
        self.call(ms + 10, "Controller_GetRobot", CONTROLLER, text("Arm"), text(""), result=ROBOT)
        self.execute(ms + 15, "GetRobotTypeName", result=text("VS-060"))

    def ready(self, ms: float = 20) -> None:
        """Take the arm and switch the motor on; takes 10 ms."""
        self.execute(ms, "TakeArm", i4s(0, 0))
        self.execute(ms + 5, "Motor", i4s(1, 0))

    def enter(self, ms: float, mode: int = 0x202) -> None:
        """Enter slave mode."""
        self.execute(ms, "slvChangeMode", i4(mode))

    def drive(self, points: int) -> float:
        """Open, enter slave mode and send set points from 50 ms on; return when the next one is due."""
        self.open()
        self.ready()
        self.enter(40)
        return self.move(50, points)

    def point(self, ms: float, first: float, code: int = 0, takes: float = 0.7) -> None:
        """Send a set point and answer with the same pose."""
        pose = r8s(first, *HOME[1:])
        answer = EMPTY if code & 0x80000000 else pose
        self.execute(ms, "slvMove", pose, answer, code=code, takes=takes)

    def move(
        self, ms: float, points: int, every: float = 8.0, first: float = 0.0, step: float = 0.05
    ) -> float:
        """Send a smooth run of set points; return when the next one is due."""
        for index in range(points):
            self.point(ms + index * every, first + index * step)
        return ms + points * every

    def leave(self, ms: float) -> None:
        """Leave slave mode and let everything go; takes 25 ms."""
        self.execute(ms, "slvChangeMode", i4(0))
        self.close(ms + 5)

    def close(self, ms: float) -> None:
        """Let everything go."""
        self.call(ms, "Robot_Release", ROBOT)
        self.call(ms + 5, "Controller_Disconnect", CONTROLLER)
        self.call(ms + 10, "Service_Stop")


class Story:
    """What one capture holds."""

    def __init__(self) -> None:
        self.talkers: list[Talker] = []

    def client(
        self, port: int = 50001, tcp: bool = False, host: str = "192.168.0.10", server_port: int = 5007
    ) -> Talker:
        """Add a client."""
        client = Host(bytes.fromhex("0200c0a8000a"), host, port)
        talker = Talker(client, SERVER._replace(port=server_port), tcp)
        self.talkers.append(talker)
        return talker

    def capture(self) -> bytes:
        """Return the bytes of a pcap file with all that was said, in order of time."""
        packets: list[Packet] = []
        for talker in self.talkers:
            packets += talker.network.packets
        packets.sort(key=lambda packet: packet.time)
        if any(packet.comment for packet in packets):
            return pcapng(packets, [Interface("any")])
        return pcap(packets, nanoseconds=True)


Play: TypeAlias = Callable[[Story], None]
"""Fills a story."""


class Diagnosed(NamedTuple):
    """What was found in a capture, and how much was seen."""

    findings: tuple[Finding, ...]
    seen: TrafficTotals

    def of(self, rule: str) -> list[Finding]:
        """Return the findings of one rule."""
        return [finding for finding in self.findings if finding.rule == rule]


def stage(play: Play) -> Diagnosed:
    """Play a scene, record it and diagnose the recording."""
    story = Story()
    play(story)
    return diagnose_bytes(story.capture())


def diagnose_bytes(capture: bytes, ports: frozenset[int] = frozenset({5007})) -> Diagnosed:
    """Diagnose a capture file."""
    decoder = PacketDecoder(ports)
    return diagnose(list(decoder.decode(CaptureFile(io.BytesIO(capture)))), decoder.comments)


def diagnose(
    observations: list[Observation], comments: Mapping[int, tuple[str, ...]] | None = None
) -> Diagnosed:
    """Diagnose observations; `comments` are those on their packets."""
    diagnosis = Diagnosis()
    pipeline = Pipeline(diagnosis, joiner=Joiner(comments or {}))
    for observation in observations:
        pipeline.add(observation)
    pipeline.finish()
    return Diagnosed(diagnosis.findings(), diagnosis.totals())


def _time(ms: float) -> int:
    return START + round(ms * MS)


def good(story: Story) -> None:
    """A whole session in which nothing is wrong."""
    client = story.client()
    client.leave(client.drive(60))
