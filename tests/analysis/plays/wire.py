"""What is wrong with the bytes, and with the capture itself."""

from __future__ import annotations

from bcapscope.protocol.codec.variant import EMPTY
from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import ROBOT, Play, Story, good
from tests.samples.calls import MS, START, i4, reply, request, text
from tests.samples.files import Packet
from tests.samples.tcp import Connection


def _long_text(length: int, answered: bool = True) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.ask(50, "Robot_Execute", ROBOT, text("x" * length), EMPTY)
        if answered:
            client.answer(51, client.serial)
        client.close(60)

    return play


def _sends(data: bytes, tcp: bool = False) -> Play:
    def play(story: Story) -> None:
        client = story.client(tcp=tcp)
        client.open()
        client.network.up(START + 50 * MS, data)

    return play


def _answers(data: bytes) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.ask(50, "Service_Stop")
        client.network.down(START + 51 * MS, data)

    return play


_SOUND = request(9, 0, "Robot_Execute", ROBOT, text("Motor"), i4(1))
_SHORT = _SOUND[:1] + (len(_SOUND) - 2).to_bytes(4, "little") + _SOUND[5:]


def _gap(story: Story) -> None:
    client = story.client(tcp=True)
    client.open()
    assert isinstance(client.network, Connection)
    client.network.down_unseen(40)
    client.execute(50, "CurJnt", result=text("y" * 40))
    client.close(60)


def _ends_in_the_middle(sent: int) -> Play:
    """A connection that ends behind so many bytes of a frame."""

    def play(story: Story) -> None:
        client = story.client(tcp=True)
        client.open()
        assert isinstance(client.network, Connection)
        client.network.up(START + 50 * MS, request(9, 0, "Service_Stop")[:sent])
        client.network.close(START + 60 * MS)

    return play


def _begins_in_the_middle(story: Story) -> None:
    client = story.client(tcp=True)
    client.network.down(START, reply(1, 0, text("y" * 40))[20:])
    client.open(10)


def _cut(story: Story) -> None:
    good(story)
    packet = story.talkers[0].network.packets[-1]
    story.talkers[0].network.packets[-1] = Packet(packet.time, packet.data[:50], length=len(packet.data))


def _ports(client_says: bytes) -> Play:
    """Two ends of which neither has the port of a controller, and that say the same to each other."""

    def play(story: Story) -> None:
        client = story.client(server_port=6000)
        client.network.up(START, client_says)
        client.network.down(START + MS, client_says)

    return play


def _one_direction(held: str) -> Play:
    """A good session of which only one direction was captured."""

    def play(story: Story) -> None:
        good(story)
        network = story.talkers[0].network
        client = bytes((192, 168, 0, 10))
        network.packets[:] = [
            packet for packet in network.packets if (packet.data[26:30] == client) is (held == "requests")
        ]

    return play


def _twice_seen(story: Story) -> None:
    client = story.client()
    client.open()
    client.ask(50, "Service_Stop")
    client.network.up(START + 55 * MS, request(client.serial, 0, "Service_Stop"))
    client.answer(51, client.serial)


def _captured_twice(story: Story) -> None:
    """A capture on two interfaces holds each packet twice."""
    client = story.client()
    client.open()
    client.close(60)
    packets = client.network.packets
    packets += [packet._replace(time=packet.time + 30_000) for packet in packets]


_UNKNOWN = request(9, 0, "Service_Start")

SCENES = (
    Scene(
        "oversize-datagram",
        _long_text(240, answered=False),
        (9,),
        ("At 0.050 s", "sent a UDP frame of 534 bytes", "b-CAP allows at most 503 bytes"),
        _long_text(150),
    ),
    Scene("near-datagram-limit", _long_text(220), (9,), ("494 bytes", "at most 503 bytes"), _long_text(150)),
    Scene(
        "malformed-request",
        _sends(_SHORT),
        (9,),
        ("Frame 9 from 192.168.0.10:50001 at 0.050 s is malformed", "can stop DENSO's C server"),
        _sends(_SOUND),
    ),
    Scene(
        "malformed-request",
        _sends(_SOUND + _SOUND),
        (9,),
        (
            f"length is {len(_SOUND)}, but the datagram has {2 * len(_SOUND)} bytes",
            "can stop DENSO's C server",
        ),
        _sends(_SOUND),
    ),
    Scene(
        "malformed-reply",
        _answers(reply(5, 0) + reply(6, 0)),
        (10,),
        ("length is 16, but the datagram has 32 bytes",),
        _answers(reply(5, 0)),
    ),
    Scene(
        "malformed-request",
        _sends(_SOUND[:9] + _SOUND, tcp=True),
        (9,),
        ("Frame 9 from 192.168.0.10:50001 at 0.050 s is malformed: a frame breaks off after 9 bytes",),
        _sends(_SOUND, tcp=True),
    ),
    Scene(
        "malformed-reply",
        _answers(reply(5, 0)[:-1] + b"\x05"),
        (10,),
        ("last byte is 05",),
        _answers(reply(5, 0)),
    ),
    Scene("capture-gap", _gap, (10,), ("lacks 40 bytes that 192.168.0.1:5007 sent",), good),
    Scene("capture-gap", _begins_in_the_middle, (2,), ("only a part of what 192.168.0.1:5007 sent",), good),
    Scene(
        "capture-gap",
        _ends_in_the_middle(15),
        (9,),
        ("the connection ended in the middle of frame 9 from 192.168.0.10:50001",),
        good,
    ),
    Scene(
        "capture-gap",
        _ends_in_the_middle(14),
        (9,),
        ("the connection ended in the middle of frame 9 from 192.168.0.10:50001",),
        good,
    ),
    Scene("capture-cut", _cut, (142,), ("the capture kept 8 of the datagram's 16 bytes",), good),
    Scene(
        "one-direction",
        _one_direction("requests"),
        (1, 71),
        ("holds only what your client sent. 192.168.0.1:5007 evidently answered",),
        good,
    ),
    Scene(
        "one-direction",
        _one_direction("replies"),
        (1, 4),
        ("holds only what 192.168.0.1:5007 sent to",),
        good,
    ),
    Scene(
        "server-guessed",
        _ports(_UNKNOWN),
        (1,),
        ("only guesses that 192.168.0.1:6000 is the controller and 192.168.0.10:50001 the client",),
        _ports(_SOUND),
    ),
    Scene(
        "duplicate-frames",
        _twice_seen,
        (9, 10, 11),
        ("frames of Service_Stop 5 more than once", "1 copy"),
        _captured_twice,
    ),
)
