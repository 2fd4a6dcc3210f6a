"""What a proxy says of its own faults while it runs is what its recording says."""

from __future__ import annotations

import json
import random
import re
import struct
from collections import Counter
from pathlib import Path

import pytest

from bcapscope.live.proxy_options import TrafficFormat
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.proxy.ring_buffer import RingRecordKind
from bcapscope.traffic.filter.field_table import RecordKind
from tests.cli.run import run
from tests.english import encoded
from tests.live.test_proxy_watcher import MS, Chain, calls, held

DROPPED, SLOW = "lossy: dropped", "slow: delayed by 20 ms"
SECOND = 1000 * MS


class Watched:
    """A chain of ring, recorder and watcher, and a client whose frames rules drop, delay or change."""

    def __init__(self, folder: Path, transport: str, shown: RecordKind | None) -> None:
        self.path = folder / "all.pcapng"
        self.chain = Chain(self.path, shown, TrafficFormat.JSON)
        self.chain.now -= 100 * SECOND
        self.chain.meet(1, transport)

    def wait(self, ns: int) -> None:
        self.chain.now += ns

    def send(self, up: bool, raw: bytes) -> None:
        self.chain.say(1, up, raw)

    def drop(self, up: bool, raw: bytes) -> None:
        self._record(up, raw, DROPPED)

    def delay(self, up: bool, raw: bytes) -> None:
        self._record(up, raw, SLOW)
        self.chain.now += 20 * MS
        self._record(up, raw, "", is_sent=True)

    def change(self, up: bool, raw: bytes, changed: bytes) -> None:
        self._record(up, raw, "bad: 1 byte corrupted")
        self._record(up, changed, "bad: 1 byte corrupted", is_sent=True)

    def lose(self, up: bool, size: int) -> None:
        """Let the ring lose bytes of a stream."""
        self.chain.now += MS
        hole = struct.pack("=QQ", size, size)
        now = self.chain.now
        self.chain.ring.write_required(RingRecordKind.HOLE, 1, hole, now, sent_at=now + 1, up=up)

    def _record(self, up: bool, raw: bytes, note: str, *, is_sent: bool = False) -> None:
        self.chain.now += MS
        came, left = (0, self.chain.now) if is_sent else (self.chain.now, 0)
        assert self.chain.ring.write_record(up, 1, came, left, raw, note=encoded(note))

    def end(self) -> str:
        """End the proxy; return all that it said."""
        self.chain.look()
        self.chain.ring.write_required(
            RingRecordKind.CLIENT_CLOSED, 1, encoded("it ended"), self.chain.now + MS
        )
        self.chain.end()
        return " ".join(" ".join(self.chain.screen.told).split())

    @property
    def shown(self) -> list[dict[str, object]]:
        return [json.loads(line) for line in self.chain.screen.shown]


def request(serial: int, first: int = 0, position: float = 1.0) -> bytes:
    pose = Variant.array(VT.R8, (position,) * 8)
    arguments = Variant(VT.I4, 2), Variant(VT.BSTR, "slvMove"), pose
    return encode_frame(serial, first, 64, arguments)


def reply(serial: int, position: float = 1.0) -> bytes:
    return encode_frame(serial, 0, 0, (Variant.array(VT.R8, (position,) * 8),))


def open_robot(watched: Watched) -> int:
    """Let a client take the robot as it does before set points; return the latest serial."""
    opening = list(calls(1))[:4]
    for serial, (function, arguments, values) in enumerate(opening, 1):
        watched.send(True, encode_frame(serial, 0, function, arguments))
        watched.send(False, encode_frame(serial, 0, 0, values))
    return len(opening)


def brief(call: dict[str, object]) -> dict[str, object]:
    """Return what live traffic and its recording have in common: not the numbers of frames."""
    kept = ("function", "command", "started", "serials", "retries", "outcome", "verdict", "latency_ms")
    return {name: call[name] for name in kept}


def recorded(path: Path) -> list[dict[str, object]]:
    found = [brief(json.loads(line)) for line in run("calls", path, "--json").out.splitlines()]
    return sorted(found, key=lambda call: str(call["started"]))


@pytest.mark.parametrize("lost", ["request", "reply"])
def test_a_loss_that_a_rule_caused_is_blamed_on_the_rule_live_as_in_the_recording(
    lost: str, tmp_path: Path
) -> None:
    watched = Watched(tmp_path, "udp", RecordKind.CALL)
    serial = open_robot(watched) + 1
    if lost == "request":
        watched.drop(True, request(serial))
    else:
        watched.send(True, request(serial))
        watched.drop(False, reply(serial))
    watched.wait(8 * MS)
    watched.send(True, request(serial + 1, serial))
    watched.send(False, reply(serial + 1))
    told = watched.end()
    assert "injected-fault" in told
    assert "lossy" in told
    assert "cable" not in told.lower().replace("network, cable and controller are not the cause", "")
    call = next(call for call in watched.shown if call["retries"])
    assert call["verdict"] == f"{lost} lost"
    found = [json.loads(line) for line in run("diagnose", watched.path, "--json").out.splitlines()]
    heads = (re.match(r" *\d+ (?:error|warning|note) ([a-z-]+)", line) for line in watched.chain.screen.told)
    assert {finding["rule"] for finding in found} == {head[1] for head in heads if head}


def test_a_dropped_reply_is_shown_with_its_rule_and_a_delayed_one_once(tmp_path: Path) -> None:
    watched = Watched(tmp_path, "udp", RecordKind.FRAME)
    watched.send(True, request(1))
    watched.drop(False, reply(1))
    watched.send(True, request(2, 1))
    watched.delay(False, reply(2))
    watched.delay(True, request(3))
    watched.chain.look()
    watched.end()
    shown = [(frame["frame"], frame["serial"], frame.get("comments", [])) for frame in watched.shown]
    assert shown == [
        (1, 1, []),
        (2, 2, []),
        (3, 2, []),
        (4, 3, [SLOW]),
        (5, 1, [DROPPED]),
    ]


class Program:
    """A client that calls, and retries over UDP, while rules of the proxy strike at random."""

    def __init__(self, watched: Watched, chance: random.Random, transport: str) -> None:
        self._watched = watched
        self._chance = chance
        self._attempts = 4 if transport == "udp" else 1
        self._serial = open_robot(watched)

    def call(self, position: float) -> None:
        first = self._serial + 1
        for attempt in range(self._attempts):
            self._serial += 1
            if self._try(self._serial, first if attempt else 0, position):
                return
            self._watched.wait(50 * MS)

    def call_undisturbed(self) -> None:
        self._serial += 1
        self._watched.send(True, request(self._serial))
        self._watched.send(False, reply(self._serial))

    def _try(self, serial: int, first: int, position: float) -> bool:
        """Send an attempt. Return whether its reply reaches the client."""
        raw = request(serial, first, position)
        how = self._chance.choice(["send"] * 6 + ["drop", "delay", "change"])
        if how == "change":
            self._watched.change(True, raw, request(serial, first, position + 0.5))
        else:
            getattr(self._watched, how)(True, raw)
        if how == "drop":
            return False
        how = self._chance.choice(["send"] * 6 + ["drop", "delay", "drop"])
        getattr(self._watched, how)(False, reply(serial, position))
        return how != "drop"


@pytest.mark.parametrize("transport", ["udp", "tcp"])
@pytest.mark.parametrize("seed", range(12))
def test_calls_and_verdicts_are_those_of_the_recording(seed: int, transport: str, tmp_path: Path) -> None:
    chance = random.Random(seed)
    watched = Watched(tmp_path, transport, RecordKind.CALL)
    program = Program(watched, chance, transport)
    for number in range(60):
        program.call(float(number))
        watched.wait(chance.randrange(1, 30) * MS)
        if chance.random() < 0.2:
            watched.chain.look()
    program.call_undisturbed()  # what was lost shows only by what came later
    watched.end()
    live = sorted(map(brief, watched.shown), key=lambda call: str(call["started"]))
    assert live == recorded(watched.path)


def test_a_hole_in_the_stream_after_a_fault_is_no_loss_in_the_proxy(tmp_path: Path) -> None:
    watched = Watched(tmp_path, "tcp", RecordKind.CALL)
    serial = open_robot(watched)
    watched.drop(True, request(serial + 1))
    for number in (2, 3, 4):
        watched.wait(8 * MS)
        watched.send(True, request(serial + number))
        if number == 3:
            watched.lose(False, len(reply(serial + number)))
        else:
            watched.send(False, reply(serial + number))
    watched.end()
    assert [(call["serials"], call["verdict"]) for call in watched.shown[-4:]] == [
        ([serial + 1], "request lost"),
        ([serial + 2], "answered"),
        ([serial + 3], "not captured"),
        ([serial + 4], "answered"),
    ]


def test_clients_leave_nothing_behind_when_they_disconnect_while_frames_wait() -> None:
    chain = Chain(None, RecordKind.CALL, TrafficFormat.JSON)

    def come_and_go(clients: range) -> Counter[str]:
        for client in clients:
            chain.meet(client, "udp")
            chain.say(client, True, request(1))
            chain.say(client, False, reply(1))
            for up, raw in ((True, request(2)), (False, reply(1))):
                assert chain.ring.write_record(up, client, chain.now, 0, raw, note=encoded(DROPPED))
            chain.ring.write_required(RingRecordKind.CLIENT_CLOSED, client, encoded("reset"), chain.now)
            chain.look()
        chain.screen.shown.clear()
        chain.screen.told.clear()
        return held()

    few, many = come_and_go(range(1, 101)), come_and_go(range(101, 201))
    kept = ("joining", "record_decoder", "conversation_pairing", "observation.Observation")
    grown = {name: (few[name], count) for name, count in many.items() if any(part in name for part in kept)}
    assert all(count <= before for before, count in grown.values()), grown


def test_a_clock_that_is_set_back_does_not_stop_the_output(tmp_path: Path) -> None:
    watched = Watched(tmp_path, "udp", RecordKind.CALL)
    serial = open_robot(watched)
    watched.drop(True, request(serial + 1))
    watched.wait(-50 * SECOND)
    watched.send(True, request(serial + 2))
    watched.send(False, reply(serial + 2))
    watched.wait(10 * SECOND)
    watched.send(True, request(serial + 3))
    watched.chain.look()
    shown = [call["serials"] for call in watched.shown]
    assert [serial + 1] in shown
    assert [serial + 2] in shown
    watched.end()
