"""Healthy sessions at random: several clients, all modes and styles, cut at either end."""

from __future__ import annotations

from random import Random

import pytest

from bcapscope.protocol.codec.variant import VT, Variant
from tests.analysis.operators import STYLES, Cell, Operator, diagnose_packets
from tests.samples.calls import i4, i4s, text
from tests.samples.findings import sentence_of

_RC7_MODES = 0x001, 0x002, 0x003, 0x101, 0x102, 0x103
_RC8_MODES = *_RC7_MODES, 0x201, 0x202, 0x203
_SESSIONS = 60


def _drives(random: Random, client: Operator) -> None:
    """Move to the first position, and drive with pauses at standstill, each in order for the mode."""
    mode = random.choice(_RC7_MODES if client.style.rc7 else _RC8_MODES)
    holds_last = bool(mode & 0x100)
    client.axis = 0.0
    client.move("@E P0", takes=100).enter(mode)
    for _ in range(random.randrange(1, 5)):
        choice = random.randrange(4)
        if choice == 0:
            client.hold(random.randrange(3, 40), random.choice((8, 50, 100)) if holds_last else 8)
        elif choice == 1:
            client.hold(4).wait(random.choice((20, 200, 3000))).hold(2)
        elif choice == 2 and holds_last:
            client.swing(100, 5.0, random.choice((1.0, 7.9)))
        else:
            client.swing(random.randrange(20, 150), random.uniform(-20, 20))
        client.hold(3)
    client.leave()


def _acts(random: Random, client: Operator) -> None:
    choice = random.randrange(12)
    if choice == 0:
        name = random.choice(("I1", "@ERROR_CODE", "@TYPE", "@SERVO_ON"))
        client.read_variable(name, i4(0), times=random.randrange(1, 30), every=random.choice((0, 5, 50)))
    elif choice == 1:
        client.move(random.choice(("@E P1", "@0 P2", "@P P3")), takes=random.choice((50, 300)))
    elif choice == 2:
        client.wait(random.choice((10, 500, 5000)))
    elif choice == 3:
        client.read_errors().clear()
    elif choice == 4:
        client.execute("ExtSpeed", i4s(50, 50))
    elif choice == 5:
        client.call("Robot_Halt", client.robot, text(""))
    elif choice == 6:
        client.motor(on=False).wait(300).motor()
    elif choice == 7:
        client.write_variable("IO24", Variant(VT.BOOL, True))
    else:
        _drives(random, client)


def _works(random: Random, client: Operator) -> None:
    client.open().ready()
    for _ in range(random.randrange(1, 6)):
        _acts(random, client)
    client.close()


def _watches(random: Random, cell: Cell, until: float) -> None:
    host = f"192.168.0.{random.randrange(20, 40)}"
    watcher = cell.operator(random.choice(STYLES[:6]), at=random.uniform(2, 50), host=host).open()
    while watcher.now < until:
        watcher.read_variable("I1", i4(1), times=3, every=20).wait(random.uniform(50, 900))
    watcher.release()


@pytest.mark.parametrize("seed", range(_SESSIONS))
def test_a_healthy_session_at_random_has_no_findings(seed: int) -> None:
    random = Random(seed)
    cell = Cell(random.choice(STYLES))
    client = cell.operator()
    _works(random, client)
    if random.random() < 0.3:
        _works(random, client.wait(random.choice((500, 3000))))
    for _ in range(random.choice((0, 0, 1, 2))):
        _watches(random, cell, client.now)
    packets = cell.packets()
    first = random.choice((0.0, random.uniform(0, 0.5)))
    last = random.choice((1.0, random.uniform(0.5, 1)))
    found = diagnose_packets(packets, first, last)
    assert [f"{each.rule}: {sentence_of(each, found.seen)}" for each in found.findings] == []
