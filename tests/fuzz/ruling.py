"""The proxy's rules: what must hold for any bytes from either side, in any order of events."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.faults.fault_injector import FaultInjector
from bcapscope.faults.fault_notation import read_fault
from bcapscope.faults.quantities import FrameCondition
from bcapscope.proxy.addons import PassingMessage
from bcapscope.proxy.intercept import Intercept
from bcapscope.proxy.policy import PolicyAction, PolicyDecision, SendAction
from bcapscope.proxy.request_guard import RequestGuard
from bcapscope.proxy.rule_policy import RulePolicy
from bcapscope.traffic.observation import (
    SERVER_PARTICIPANT,
    Conversation,
    Direction,
    Endpoint,
    Transport,
)
from tests.proxy.scripting import Here

MS = 1_000_000
TCP, GUARDED, HELD, SHOWN = 1, 2, 4, 8
"""Bits of the first byte; the upper four say which faults there are."""

IDLE = ("drop if serial == 70000", "loss=0%", "delay=3ms after 1000s")
"""Faults that look at everything and strike nothing."""

FAULTS = (
    IDLE,
    ("delay=3ms±2ms", "reorder=2 20%", "duplicate 20%"),
    ("corrupt=3", "truncate 20%"),
    ("garbage 30%", "serial", "answer=E_FAIL if command == slvMove"),
    ("rewrite set arg[0]=7 set arg[2][0]=1 limit arg[2]=-9..9 step arg[2]=0.5",),
    ("executing=9ms every 3ms 50%", "burst=20%/30%"),
    ("bandwidth=64kB/s", "partition after 5ms for 20ms"),
    ("close 10%", "half-open 5%", "drop try 2", "drop if arg[2][0] > 5 or hresult != S_OK"),
)


class _Addon:
    """Takes hold of all that can be taken hold of."""

    def request(self, message: PassingMessage) -> None:
        assert isinstance(message.values, list)
        if message.command == "drop":
            message.drop()

    def reply(self, message: PassingMessage) -> None:
        message.data = bytes(message.data)

    def settled(self, call: object) -> None:
        assert call is not None


def rules(data: bytes) -> None:
    """Let one client's traffic pass: a byte that sets up, then steps of two bytes and what comes.

    The first byte of a step says what happens and how much later, the second how many bytes come.
    """
    if not data:
        return
    made, faults, here = _set_up(data[0])
    came, left = {side: b"" for side in Direction}, {side: b"" for side in Direction}
    now = 0
    for what, later, content in _steps(data[1:]):
        now += later * MS
        if what in (0, 1):
            side = Direction.RESPONSE if what else Direction.REQUEST
            came[side] += content
            _take(made.receive(1, side, content, now).actions, left)
        elif what == 2 and made.intercept.held:
            made.forward_held(made.intercept.held[0].number, now, content or None)
        elif what == 3:
            made.on_rules_changed(now)
            if here is not None and later == 1:
                made.on_script_data(b"", now)
        if here is not None and later != 2:
            here.answer(made, now)
        _take(made.pop_due_actions(now), left)
        due = made.due()
        assert due is None or due >= now or due == 0
    for side in Direction:
        _take(made.on_stream_end(1, side, now), left)
    if here is not None:
        here.answer(made, now)
        _take(made.pop_due_actions(now), left)
    if faults is IDLE and not data[0] & (GUARDED | HELD | SHOWN):
        assert left == came
        assert made.due() is None
    made.remove_client(1, now)
    made.close(now)
    assert list(made.pop_due_actions(now + 10**13)) == []
    assert made.due() is None


def _set_up(choice: int) -> tuple[RulePolicy, tuple[str, ...], Here | None]:
    faults = FAULTS[(choice >> 4) % len(FAULTS)]
    here = Here(_Addon()) if choice & SHOWN else None
    made = RulePolicy(
        FaultInjector(map(read_fault, faults), seed=1, now=0),
        RequestGuard(read_only=True) if choice & GUARDED else None,
        Intercept(FrameCondition.read("serial < 5"), 20 * MS) if choice & HELD else None,
        None if here is None else here.queue,
    )
    transport = Transport.TCP if choice & TCP else Transport.UDP
    ends = Endpoint("10.0.0.2", 50001), Endpoint("10.0.0.1", 5007)
    made.add_client(1, Conversation(*ends, transport, SERVER_PARTICIPANT), 0)
    return made, faults, here


def _steps(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Give what happens, how many ms later, and the bytes that come."""
    at = 0
    while at + 2 <= len(data):
        size = data[at + 1]
        yield data[at] & 3, data[at] >> 2, data[at + 2 : at + 2 + size]
        at += 2 + size


def _take(actions: object, left: dict[Direction, bytes]) -> None:
    assert isinstance(actions, list | tuple)
    for action in actions:
        taken: PolicyAction = action
        assert taken.client == 1
        if isinstance(taken, PolicyDecision):
            _take(taken.actions, left)
        elif isinstance(taken, SendAction):
            left[taken.toward] += taken.data
