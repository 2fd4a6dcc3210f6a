"""Find slave-mode sessions in completed calls."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from bcapscope.analysis.slave.controller_state import ControllerState, call_fact
from bcapscope.analysis.slave.generation_clues import clue_of_call, clue_of_set_point, stronger_clue
from bcapscope.analysis.slave.notable_set_points import MAX_LISTED
from bcapscope.analysis.slave.session_builder import (
    BATCH_SIZE,
    SessionKey,
    SetPointHandler,
    SlaveSessionBuilder,
)
from bcapscope.analysis.slave.session_models import SlaveSetup
from bcapscope.analysis.slave.set_point_batch import LARGE_FRAME
from bcapscope.analysis.slave.slave_session import CallFact, ExitReason, SessionExit, SlaveSession
from bcapscope.protocol.codec.variant import integer_value
from bcapscope.protocol.tables.call_effect import CallEffect, function_effect
from bcapscope.protocol.tables.command_catalogue import command_parameter, find_command
from bcapscope.protocol.tables.function_table import ID
from bcapscope.protocol.tables.hresult import ends_slave_mode, is_failure
from bcapscope.traffic.bounded_dict import BoundedDict
from bcapscope.traffic.call import Call
from bcapscope.traffic.observation import Conversation, Endpoint
from bcapscope.traffic.slave_mode_tracker import (
    SlaveModeEffect,
    is_set_point,
    requested_mode,
    slave_mode_effect,
)

HOLD_BACK_NS = 6_000_000_000
"""Time in ns from the end of a session until the detector returns it. Meanwhile, the detector may get the
call that shows why the session ended.
"""

SILENCE_NS = 1_000_000_000
"""A client counts as stopped if it was silent for longer than this time (ns) when the capture ended."""

SUSPECT_WITHIN_NS = 2_000_000_000
"""Maximum time in ns between a failed call that ended slave mode and the reply that shows slave mode off."""

STILL_TAKING_NS = 200_000_000
"""After an error that ends slave mode, a controller may still accept set points for at most this time in ns.
No source states this value. bcapscope assumes that the robot brakes for at most 25 cycles of 8 ms.
"""

BEFORE_NS, AFTER_NS = 1_000_000_000, 500_000_000
"""`SlaveSession.other_calls` includes calls up to `BEFORE_NS` before and `AFTER_NS` after a session."""

MAX_SESSIONS = 64
"""Maximum number of open sessions. A further session ends the session that was silent longest."""

MAX_HELD_BACK = 256
"""Maximum number of ended sessions that are held back (see `HOLD_BACK_NS`). If a further session ends, the
detector returns the oldest one at once.
"""

MAX_CONTROLLERS = 64

_ROBOT_EXECUTE = ID["Robot_Execute"]
_HANDLE = slice(15, 29)


class _EndedSession(NamedTuple):
    builder: SlaveSessionBuilder
    exit: SessionExit
    slave_setup: SlaveSetup


class SlaveSessionDetector:
    """Finds slave-mode sessions in calls, which must be added in the order in which a tracker completes them.

    The memory use depends on the number of open sessions, not on their duration.
    """

    def __init__(self, window: int | None = None, on_set_points: SetPointHandler | None = None) -> None:
        """`window` is the length in ns of the time slices for which figures are computed. `on_set_points`
        receives the set points of all sessions, up to `BATCH_SIZE` at a time.
        """
        self._window = window
        self._on_set_points = on_set_points
        self._controllers: BoundedDict[Endpoint, ControllerState] = BoundedDict(MAX_CONTROLLERS)
        self._active: dict[SessionKey, SlaveSessionBuilder] = {}
        self._recently_ended: BoundedDict[SessionKey, SlaveSessionBuilder] = BoundedDict(MAX_SESSIONS)
        self._held_back: deque[_EndedSession] = deque()
        self._session_count = 0
        self._latest_time = 0
        self._remaining: tuple[int, tuple[SlaveSession, ...]] | None = None

    def add_call(self, call: Call) -> Sequence[SlaveSession]:
        """Add a completed call; return the slave-mode sessions that are now complete."""
        self._remaining = None
        effect = slave_mode_effect(call)
        if is_set_point(call.kind):
            self._on_set_point(call, effect)
        else:
            self._on_other_call(call, effect)
        return self._on_time(call)

    def add_set_points(self, calls: Sequence[Call]) -> Sequence[SlaveSession]:
        """Add a series of set points of one client (see `AlikeSetPoints`); return the same as `add_call`."""
        self._remaining = None
        first = calls[0]
        builder = self._active.get((first.conversation, first.request.item.raw[_HANDLE]))
        if builder is None or builder.error_exit is not None:
            return [session for call in calls for session in self.add_call(call)]
        batch = builder.batch
        finished: Sequence[SlaveSession] = ()
        while calls:
            room = BATCH_SIZE - len(batch)
            batch.add_run(calls[:room])
            if len(batch) >= BATCH_SIZE:
                self._process_batch(builder)
                finished = (*finished, *self._on_time(calls[min(room, len(calls)) - 1]))
            calls = calls[room:]
        return finished

    def _on_time(self, call: Call) -> Sequence[SlaveSession]:
        self._latest_time = max(self._latest_time, call.last_activity)
        return self._release_ended(self._latest_time - HOLD_BACK_NS) if self._held_back else ()

    def close_conversation(self, conversation: Conversation) -> tuple[SlaveSession, ...]:
        """End and return the sessions of a closed conversation, and forget the conversation."""
        self._remaining = None
        for builder in [each for each in self._unfinished if each.conversation is conversation]:
            self._end_session(builder, _silent_exit(builder))
        for key in [key for key in self._recently_ended if key[0] is conversation]:
            del self._recently_ended[key]
        found = [each for each in self._held_back if each.builder.conversation is conversation]
        self._held_back = deque(
            each for each in self._held_back if each.builder.conversation is not conversation
        )
        return tuple(map(self._make_session, found))

    def remaining_sessions(self, ended_at: int = 0) -> tuple[SlaveSession, ...]:
        """Return the sessions that were not returned yet, as if the traffic had ended at `ended_at` or at the
        last frame, whichever is later. This method changes nothing.
        """
        # Cached, because a live diagnosis needs the result twice; computing it can take 13 ms.
        unfinished = self._unfinished
        end = max((self._latest_time, ended_at, *(builder.last_activity for builder in unfinished)))
        if self._remaining is None or self._remaining[0] != end:
            ended = (*self._held_back, *(self._ended_with_traffic(builder, end) for builder in unfinished))
            sessions = sorted(map(self._make_session, ended), key=lambda session: session.number)
            self._remaining = end, tuple(sessions)
        return self._remaining[1]

    def process_waiting(self) -> None:
        """Process all stored set points, and pass them to `on_set_points`."""
        for builder in self._unfinished:
            self._process_batch(builder)

    @property
    def _unfinished(self) -> Sequence[SlaveSessionBuilder]:
        """Sessions that have not ended; sessions with set points come first."""
        waiting = (
            builder for known in self._controllers.values() for builder in known.pending_sessions.values()
        )
        return (*self._active.values(), *waiting)

    def _on_set_point(self, call: Call, effect: SlaveModeEffect | None) -> None:
        key = call.conversation, call.request.item.body[_HANDLE]
        code, builder = call.hresult, self._active.get(key)
        if effect is SlaveModeEffect.FOUND_OFF:
            self._on_found_off(key, builder, call)
            return
        failed = effect is SlaveModeEffect.SET_POINT_FAILED
        if builder is None:
            if self._is_outside_session(key, call, failed):
                return
            builder = self._begin_session(key, call)
        if builder.error_exit is not None:
            if code is None or failed:
                builder.after_end += 1
                return
            builder.error_exit = None
        builder.batch.add(call)
        if failed:
            builder.error_exit = _exit_by_call(ExitReason.ERROR, call)
        if len(builder.batch) >= BATCH_SIZE or len(call.request.item.raw) > LARGE_FRAME:
            self._process_batch(builder)

    def _is_outside_session(self, key: SessionKey, call: Call, failed: bool) -> bool:
        """Return True if a set point belongs to no slave-mode session, and does not begin a session."""
        if self._controller(call).pending_sessions or not (failed or call.reply is None):
            return False
        ended = self._recently_ended.get(key)
        if ended is not None:
            ended.after_end += 1
        return failed or ended is not None

    def _begin_session(self, key: SessionKey, call: Call) -> SlaveSessionBuilder:
        controller = self._controller(call)
        parameter = command_parameter(call.request.item.variants)
        if parameter is not None:
            controller.clue = stronger_clue(controller.clue, clue_of_set_point(parameter))
        builder = controller.claim_pending(key)
        if builder is None:
            entry = controller.claim_unanswered_entry()
            builder = self._new_builder(key, entry, controller.reported_mode)
        if len(self._active) >= MAX_SESSIONS:
            silent = min(self._active.values(), key=lambda each: each.last_activity)
            self._end_session(silent, _silent_exit(silent))
        builder.position, controller.position = controller.position, None
        self._active[key] = builder
        self._recently_ended.pop(key, None)
        return builder

    def _new_builder(
        self, key: SessionKey, entry: CallFact | None, mode: tuple[int | None, str]
    ) -> SlaveSessionBuilder:
        self._session_count += 1
        return SlaveSessionBuilder(
            self._session_count, key, entry, mode, window=self._window, on_set_points=self._on_set_points
        )

    def _on_found_off(self, key: SessionKey, builder: SlaveSessionBuilder | None, call: Call) -> None:
        if builder is None and key in self._controller(call).pending_sessions:
            builder = self._begin_session(key, call)
        if builder is None:
            builder = self._recently_ended.get(key)
        else:
            self._end_session(builder, _exit_by_call(ExitReason.FOUND_OFF, call))
        if builder is not None:
            builder.after_end += 1

    def _on_other_call(self, call: Call, effect: SlaveModeEffect | None) -> None:
        controller = self._controller(call)
        controller.clue = stronger_clue(controller.clue, clue_of_call(call))
        controller.remember_call(call)
        for builder in self._active.values():
            if builder.conversation is call.conversation:
                builder.batch.add_other_call(call)
        if _may_move_robot(call):
            controller.position = None
        function_id, command = call.kind
        if effect is SlaveModeEffect.SESSION_BOUNDARY:
            self._on_disconnect(call, None)
        elif effect is SlaveModeEffect.ROBOT_RELEASED:
            self._on_disconnect(call, call.request.item.body[_HANDLE])
        elif effect is SlaveModeEffect.MODE_CHANGED:
            self._on_change_mode(call, controller)
        elif function_id == _ROBOT_EXECUTE and command is not None and not is_failure(call.hresult or 0):
            self._on_robot_call(call, call.kind.folded_command, controller)

    def _on_robot_call(self, call: Call, command: str, controller: ControllerState) -> None:
        if call.reply is not None and command in ("slvsendformat", "slvrecvformat"):
            for builder in self._active.values():
                if builder.models is None and builder.conversation.server == call.conversation.server:
                    self._process_batch(builder)
            controller.record_format(call, command)
        elif call.reply is not None and command == "slvgetmode":
            self._on_get_mode(call, controller)
        elif call.reply is not None:
            controller.record_position(call, command)

    def _on_change_mode(self, call: Call, controller: ControllerState) -> None:
        value = requested_mode(call)
        if call.reply is None and not call.reply_not_captured:
            controller.unanswered_entry = call if value else None
            return
        key = call.conversation, call.request.item.body[_HANDLE]
        builder = self._active.get(key) or controller.pending_sessions.get(key)
        if builder is not None:
            reason = ExitReason.CHANGED if value else ExitReason.LEFT
            self._end_session(builder, _exit_by_call(reason, call))
        controller.unanswered_entry = None
        controller.reported_mode = (None, "")
        if value != 0:
            entered = self._new_builder(key, call_fact(call), (value, "slvChangeMode"))
            dropped = controller.add_pending(key, entered)
            if dropped is not None:
                self._end_session(dropped, _silent_exit(dropped))

    def _on_get_mode(self, call: Call, controller: ControllerState) -> None:
        arguments = () if call.reply is None else call.reply.item.arguments
        value = integer_value(arguments[0].variant) if arguments else None
        if not value:
            return
        controller.reported_mode = value, "slvGetMode"
        builder = self._active.get((call.conversation, call.request.item.body[_HANDLE]))
        if builder is not None and builder.mode[0] is None:
            builder.mode = controller.reported_mode

    def _on_disconnect(self, call: Call, handle: bytes | None) -> None:
        """End the sessions of the call's client; with `handle`, only those of the robot with this handle."""
        pending = self._controller(call).pending_sessions
        for builder in (*self._active.values(), *pending.values()):
            if builder.conversation is call.conversation and handle in (None, builder.handle):
                self._end_session(builder, _exit_by_call(ExitReason.DISCONNECTED, call))

    def _end_session(self, builder: SlaveSessionBuilder, exit_: SessionExit) -> None:
        """End a session. If the session has an `error_exit`, ignore `exit_`."""
        controller = self._controller_of(builder)
        if self._active.pop(builder.key, None) is not None:
            controller.position = None
        controller.pending_sessions.pop(builder.key, None)
        self._recently_ended[builder.key] = builder
        slave_setup = self._slave_setup(builder)
        builder.process_batch(slave_setup)
        self._held_back.append(_EndedSession(builder, builder.error_exit or exit_, slave_setup))

    def _ended_with_traffic(self, builder: SlaveSessionBuilder, ended_at: int) -> _EndedSession:
        last = builder.last_activity
        reason = ExitReason.SILENT if ended_at - last > SILENCE_NS else ExitReason.CAPTURE_ENDED
        exit_ = builder.error_exit or SessionExit(reason, last, (), None, None)
        slave_setup = self._slave_setup(builder)
        return _EndedSession(builder.processed(slave_setup), exit_, slave_setup)

    def _release_ended(self, before: int) -> list[SlaveSession]:
        sessions = []
        ended = self._held_back
        while ended and (ended[0].exit.time <= before or len(ended) > MAX_HELD_BACK):
            sessions.append(self._make_session(ended.popleft()))
        return sessions

    def _make_session(self, ended: _EndedSession) -> SlaveSession:
        builder = ended.builder
        controller = self._controller_of(builder)
        exit_ = _find_exit_cause(ended, controller)
        others = controller.calls_between(builder.began_at(exit_.time) - BEFORE_NS, exit_.time + AFTER_NS)
        return builder.session(exit_, ended.slave_setup, tuple(map(call_fact, others[-MAX_LISTED:])))

    def _process_batch(self, builder: SlaveSessionBuilder) -> None:
        builder.process_batch(self._slave_setup(builder))

    def _slave_setup(self, builder: SlaveSessionBuilder) -> SlaveSetup:
        return self._controller_of(builder).slave_setup(builder.mode, builder.position)

    def _controller_of(self, builder: SlaveSessionBuilder) -> ControllerState:
        return self._controllers.get(builder.conversation.server) or ControllerState()

    def _controller(self, call: Call) -> ControllerState:
        server = call.conversation.server
        controller = self._controllers.get(server)
        if controller is None:
            controller = self._controllers[server] = ControllerState()
        return controller


def _call_end(call: Call) -> int:
    return call.request.time if call.reply is None else call.reply.time


def _find_exit_cause(ended: _EndedSession, controller: ControllerState) -> SessionExit:
    """Return how a session ended. If the session's own calls do not show what ended slave mode, search the
    recent calls of all clients of the controller for the cause.
    """
    builder, exit_, _ = ended
    if exit_.reason not in (ExitReason.FOUND_OFF, ExitReason.SILENT, ExitReason.CAPTURE_ENDED):
        return exit_
    began = builder.began_at(exit_.time)
    last = began if builder.last_accepted is None else builder.last_accepted
    found_off = exit_.reason is ExitReason.FOUND_OFF
    until = exit_.time if found_off else max(exit_.time, last) + SILENCE_NS
    recent = max(began, last - STILL_TAKING_NS, exit_.time - SUSPECT_WITHIN_NS)
    nearby = [call for call in controller.calls_between(min(recent, last), until) if _call_end(call) <= until]
    changes = [call for call in nearby if _call_end(call) >= last and _switches_off(call, builder)]
    if changes:
        return _exit_by_call(ExitReason.OTHER_CLIENT, changes[-1], exit_.frames)
    failures = [call for call in nearby if _call_end(call) >= recent and ends_slave_mode(call.hresult or 0)]
    return (
        _exit_by_call(ExitReason.OTHER_CALL, failures[-1], exit_.frames) if failures and found_off else exit_
    )


def _silent_exit(builder: SlaveSessionBuilder) -> SessionExit:
    return SessionExit(ExitReason.SILENT, builder.last_activity, (), None, None)


def _exit_by_call(reason: ExitReason, call: Call, frames: tuple[int, ...] = ()) -> SessionExit:
    own = tuple(seen.number for seen in (call.request, call.reply) if seen is not None)
    return SessionExit(reason, _call_end(call), (*own, *frames), call.hresult, call_fact(call))


def _switches_off(call: Call, builder: SlaveSessionBuilder) -> bool:
    foreign = call.conversation is not builder.conversation
    return foreign and call.hresult is not None and not is_failure(call.hresult) and requested_mode(call) == 0


def _may_move_robot(call: Call) -> bool:
    function_id, command = call.kind
    if command is None:
        return function_effect(function_id) is CallEffect.MOVES
    known = find_command(function_id, command)
    return known is None or known.effect is CallEffect.MOVES
