"""What is in sight at all times: connection, slave mode, armed or not, HALT."""

from __future__ import annotations

from bcapscope.protocol.slavemode import mode_pose_type
from bcapscope.render.escape import printable
from bcapscope.tui.desk.arming import Arming
from bcapscope.tui.desk.halt import HaltNews, HaltState
from bcapscope.tui.desk.news import Status
from bcapscope.tui.desk.pulse import Pulse
from bcapscope.tui.words import say

Piece = tuple[str, str]
"""A text and the name of its ink."""

_LONGEST_HOST = 24
_SECOND = 1_000_000_000
_LONG = 3 * _SECOND
_HALT_INKS = {HaltState.READY: "good", HaltState.HALTED: "bad", HaltState.OPENING: "dim"}


def status_text(status: Status, arming: Arming, now: int, halt: HaltNews, pulse: Pulse) -> list[Piece]:
    """Write the line, piece by piece."""
    if status.target is None:
        return [(f" {say('tester.status.none')} ", "dim")]
    age = pulse.age(now)
    if pulse.is_silent(now):
        pieces = [
            _peer(status, "◌", "bad"),
            (f"{say('tester.status.silent', seconds=age // _SECOND)} ", "bad"),
        ]
    elif age >= _LONG:  # nothing is asked, as in slave mode, so that it may be there or not
        pieces = [_peer(status, "●", ""), (f"{say('tester.status.age', seconds=age // _SECOND)} ", "dim")]
    else:
        took = f"{status.round_trip / 1e6:.1f} ms " if status.round_trip else ""
        pieces = [_peer(status, "●", "good"), (took, "dim")]
    if status.slave_mode:
        kind = mode_pose_type(status.slave_mode) or ""
        pieces.append(
            (f" {say('tester.status.slave', mode=f'{status.slave_mode:03X}', kind=kind)} ", "problem")
        )
    pieces.append(_arms(arming, now))
    pieces.append((f" F12 {say(f'tester.halt.{halt.state}')} ", _HALT_INKS.get(halt.state, "bad")))
    return pieces


def _peer(status: Status, mark: str, ink: str) -> Piece:
    assert status.target is not None
    name = say("tester.status.simulator")
    if not status.identity.simulator:
        name = printable(status.target.host)[:_LONGEST_HOST]
    return f" {mark} {name} ", ink


def _arms(arming: Arming, now: int) -> Piece:
    if not arming.needed:
        return f" {say('tester.status.free')} ", "good"
    if not arming.is_armed(now):
        return f" {say('tester.status.safe')} ", "good"
    seconds = arming.left(now) // _SECOND
    return f" {say('tester.status.armed')} {seconds // 60}:{seconds % 60:02d} ", "bad"


def facts_of(status: Status) -> list[str]:
    """Say what is known of the controller and its robot, a line each, before anything moves."""
    identity, robot = status.identity, status.robot
    unknown = say("tester.fact.unknown")
    return [
        say("tester.fact.peer", peer=printable(str(status.target))),
        say("tester.fact.version", version=printable(identity.version) or unknown),
        say("tester.fact.robot", robot=printable(robot.label) if robot else unknown),
        say(
            "tester.fact.type",
            name=printable(identity.type_name) or unknown,
            number=printable(identity.type_number) or unknown,
        ),
    ]
