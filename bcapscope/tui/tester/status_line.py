"""The status line that is always visible: connection, slave mode, arming state, HALT."""

from __future__ import annotations

from bcapscope.live.controller.arming_state import ArmingState
from bcapscope.live.controller.halt_connection import HaltState, HaltUpdate
from bcapscope.live.controller.reply_monitor import ReplyMonitor
from bcapscope.live.controller.session_updates import SessionStatus
from bcapscope.protocol.slave_mode.modes import pose_type_of_mode
from bcapscope.render.escape import printable
from bcapscope.tui.reader_language import label

StatusPiece = tuple[str, str]
"""A piece of the status line: a text and the name of its style."""

_MAX_HOST_LENGTH = 24
_SECOND = 1_000_000_000
_LONG_SILENCE = 3 * _SECOND
_HALT_STYLES = {HaltState.READY: "good", HaltState.HALTED: "bad", HaltState.OPENING: "dim"}


def status_pieces(
    status: SessionStatus, arming: ArmingState, now: int, halt: HaltUpdate, reply_monitor: ReplyMonitor
) -> list[StatusPiece]:
    if status.target is None:
        return [(f" {label('tester.status.none')} ", "dim")]
    age = reply_monitor.silence(now)
    if reply_monitor.is_reply_overdue(now):
        pieces = [
            _peer_piece(status, "◌", "bad"),
            (f"{label('tester.status.silent', seconds=age // _SECOND)} ", "bad"),
        ]
    elif age >= _LONG_SILENCE:  # no reply is due, as in slave mode, so the controller may be reachable or not
        pieces = [
            _peer_piece(status, "●", ""),
            (f"{label('tester.status.age', seconds=age // _SECOND)} ", "dim"),
        ]
    else:
        took = f"{status.round_trip / 1e6:.1f} ms " if status.round_trip else ""
        pieces = [_peer_piece(status, "●", "good"), (took, "dim")]
    if status.slave_mode:
        kind = pose_type_of_mode(status.slave_mode) or ""
        pieces.append(
            (f" {label('tester.status.slave', mode=f'{status.slave_mode:03X}', kind=kind)} ", "problem")
        )
    pieces.append(_arming_piece(arming, now))
    pieces.append((f" F12 {label(f'tester.halt.{halt.state}')} ", _HALT_STYLES.get(halt.state, "bad")))
    return pieces


def _peer_piece(status: SessionStatus, mark: str, ink: str) -> StatusPiece:
    assert status.target is not None
    name = label("tester.status.simulator")
    if not status.identity.is_simulator:
        name = printable(status.target.host)[:_MAX_HOST_LENGTH]
    return f" {mark} {name} ", ink


def _arming_piece(arming: ArmingState, now: int) -> StatusPiece:
    if not arming.is_required:
        return f" {label('tester.status.free')} ", "good"
    if not arming.is_armed(now):
        return f" {label('tester.status.safe')} ", "good"
    seconds = arming.remaining(now) // _SECOND
    return f" {label('tester.status.armed')} {seconds // 60}:{seconds % 60:02d} ", "bad"


def arming_facts(status: SessionStatus) -> list[str]:
    """Return lines on the controller and its robot, which the user reads before arming."""
    identity, robot = status.identity, status.robot
    unknown = label("tester.fact.unknown")
    return [
        label("tester.fact.peer", peer=printable(str(status.target))),
        label("tester.fact.version", version=printable(identity.version) or unknown),
        label("tester.fact.robot", robot=printable(robot.label) if robot else unknown),
        label(
            "tester.fact.type",
            name=printable(identity.type_name) or unknown,
            number=printable(identity.type_number) or unknown,
        ),
    ]
