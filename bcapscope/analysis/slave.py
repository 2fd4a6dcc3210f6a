"""Stays in slave mode, found in calls as they settle."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

from bcapscope.analysis.batch import HANDLE_VALUE, HEAD_SIZE, LARGE, Batch
from bcapscope.analysis.controller import Controller, fact_of, mode_asked
from bcapscope.analysis.course import BATCH, Course, Key, Setting, parameter_of
from bcapscope.analysis.generation import better, clue_of_call, clue_of_set_point
from bcapscope.analysis.moments import MOST_LISTED
from bcapscope.analysis.points import Heed
from bcapscope.analysis.stay import Exit, ExitReason, Stay
from bcapscope.protocol.functions import ID
from bcapscope.protocol.hresult import E_NOT_IN_SLAVE_MODE, E_SLAVE_OVERFLOW, ends_slave_mode, is_failure
from bcapscope.protocol.slavemode import mode_value
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.observation import Conversation, Endpoint
from bcapscope.traffic.question import Question

OFF_CODES = frozenset((E_NOT_IN_SLAVE_MODE, 0x83501033, 0x8120184E))
"""A set point, or another command that needs slave mode, came while it is off."""

HELD_NS = 6_000_000_000
"""How long a stay that ended is held back: calls of other clients may settle so much later, and one of them
may be what ended it."""

SILENCE_NS = 1_000_000_000
"""A client without set points for so long before the capture ends has stopped sending them."""

SUSPICION_NS = 2_000_000_000
"""A call of anyone that failed so long before slave mode was found off may be why."""

DROPPING_NS = 200_000_000
"""How long a controller may go on taking set points after the error that makes it leave slave mode. No paper
says; 25 cycles leave room for one that stops on its path first."""

BEFORE_NS, AFTER_NS = 1_000_000_000, 500_000_000
"""How long before and after a stay other calls are told with it."""

MOST_STAYS = 64
"""Stays that go on at a time; of more, the one that was silent longest ends."""

MOST_ENDED = 256
"""Stays held back; of more, the oldest is given out at once."""

MOST_CONTROLLERS = 64

_ROBOT_EXECUTE, _ROBOT_RELEASE = ID["Robot_Execute"], ID["Robot_Release"]
_ENDS = frozenset(ID[name] for name in ("Service_Start", "Service_Stop", "Controller_Disconnect"))
_FULL = BATCH * HEAD_SIZE
_HANDLE = slice(15, 29)


_Latest: TypeAlias = "tuple[Question | None, Conversation | None, Batch]"
_NOTHING: _Latest = (None, None, Batch())


class _Ended(NamedTuple):
    """A stay that ended and is held back."""

    course: Course
    exit: Exit
    setting: Setting


class SlaveWatcher:
    """Finds stays in slave mode; takes calls as a tracker gives them out.

    Memory is bounded by the stays that go on at a time, each by its figures, not by how long they last.
    """

    def __init__(self, window: int | None = None, heed: Heed | None = None) -> None:
        """Begin.

        Args:
            window: length of a slice of time in nanoseconds, where figures by time are wanted.
            heed: is given the set points as they are looked at, for who wants each of them.
        """
        self._window = window
        self._heed = heed
        self._controllers: dict[Endpoint, Controller] = {}
        self._courses: dict[Key, Course] = {}
        self._closing: dict[Course, Exit] = {}  # an error ended it, unless a set point is accepted after all
        self._over: dict[Key, Course] = {}
        self._ended: deque[_Ended] = deque()
        self._started = 0
        self._seen = 0
        # The stay of the last set point, and what tells the next one of it at a glance.
        self._course: Course | None = None
        self._latest = _NOTHING

    def take(self, call: Exchange) -> Sequence[Stay]:
        """Take in a call that settled; return the stays of which no more is to be expected."""
        question, conversation, batch = self._latest
        reply = call.reply
        if (
            call.question is question
            and call.conversation is conversation
            and reply is not None
            and not call.others
            and batch.keep(call, reply)
        ):
            return () if len(batch.heads) < _FULL else self._look(call, kept=True)
        return self._look(call)

    def _look(self, call: Exchange, kept: bool = False) -> Sequence[Stay]:
        """Take in a call of any kind, or one that is `kept` already."""
        if kept and self._course is not None:
            self._flush(self._course)
        elif is_set_point(call):
            self._set_point(call)
        else:
            self._other(call)
        self._seen = max(self._seen, call.activity)
        return self._release(self._seen - HELD_NS) if self._ended else ()

    def forget(self, conversation: Conversation) -> tuple[Stay, ...]:
        """Return the stays of a client that were not given out yet, and forget it: it is gone."""
        for course in [each for each in self._running if each.conversation is conversation]:
            self._close(course, Exit(ExitReason.SILENT, course.last_seen, (), None, None))
        for key in [key for key in self._over if key[0] is conversation]:
            del self._over[key]
        found = [each for each in self._ended if each.course.conversation is conversation]
        self._ended = deque(each for each in self._ended if each.course.conversation is not conversation)
        return tuple(self._stay(each) for each in found)

    def finish(self, ended: int = 0) -> tuple[Stay, ...]:
        """Return the stays that were not given out yet; the traffic has ended.

        Args:
            ended: when, nanoseconds since 1970; the last frame of a call at the earliest.
        """
        courses = self._running
        ends = [course.last_seen for course in courses]
        seen = max((self._seen, ended, *ends))
        for course, last in zip(courses, ends, strict=True):
            reason = ExitReason.SILENT if seen - last > SILENCE_NS else ExitReason.CAPTURE_ENDED
            self._close(course, Exit(reason, last, (), None, None))
        return tuple(sorted(self._release(None), key=lambda stay: stay.number))

    @property
    def _running(self) -> Sequence[Course]:
        """The stays that have not ended, and after them those that have no set point so far."""
        waiting = (course for known in self._controllers.values() for course in known.waiting.values())
        return (*self._courses.values(), *waiting)

    # set points

    def _set_point(self, call: Exchange) -> None:
        key = call.conversation, call.request.item.body[_HANDLE]
        code, course = call.hresult, self._courses.get(key)
        if code in OFF_CODES:
            self._found_off(key, course, call)
            return
        failed = code is not None and is_failure(code) and code != E_SLAVE_OVERFLOW
        if course is None:
            if self._is_outside(key, call, failed):
                return
            course = self._begin(key, call)
        if course in self._closing:
            if code is None or failed:
                course.after_end += 1
                return
            del self._closing[course]
        course.batch.add(call)
        if failed:
            self._closing[course] = Exit(
                ExitReason.ERROR, _end_of(call), _frames_of(call), code, fact_of(call)
            )
        self._look_at(None if failed else course, call)
        if len(course.batch) >= BATCH or len(call.request.item.raw) > LARGE:
            self._flush(course)

    def _is_outside(self, key: Key, call: Exchange, failed: bool) -> bool:
        """Tell whether a set point that belongs to no stay begins none either."""
        if self._controller(call).waiting or not (failed or call.reply is None):
            return False
        over = self._over.get(key)
        if over is not None:
            over.after_end += 1
        return failed or over is not None

    def _begin(self, key: Key, call: Exchange) -> Course:
        controller = self._controller(call)
        parameter = parameter_of(call.request.item)
        if parameter is not None:
            controller.clue = better(controller.clue, clue_of_set_point(parameter))
        course = controller.adopt(key)
        if course is None:
            self._started += 1
            tried = controller.take_tried()
            course = Course(
                self._started, key, tried, controller.mode_told, window=self._window, heed=self._heed
            )
        self._courses[key] = course
        self._over.pop(key, None)
        if len(self._courses) > MOST_STAYS:
            silent = min(self._courses.values(), key=lambda each: each.last_seen)
            self._close(silent, Exit(ExitReason.SILENT, silent.last_seen, (), None, None))
        return course

    def _found_off(self, key: Key, course: Course | None, call: Exchange) -> None:
        if course is None and key in self._controller(call).waiting:
            course = self._begin(key, call)
        if course is None:
            course = self._over.get(key)
        else:
            found = Exit(ExitReason.FOUND_OFF, _end_of(call), _frames_of(call), call.hresult, fact_of(call))
            self._close(course, found)
        if course is not None:
            course.after_end += 1

    def _look_at(self, course: Course | None, call: Exchange) -> None:
        """Expect the next set point to be one of `course`; a compressed one has its handle elsewhere."""
        raw = call.request.item.raw
        if course is not None and call.request.item.body is raw:
            self._course = course
            course.batch.handle = raw[HANDLE_VALUE]
            self._latest = call.question, call.conversation, course.batch
        else:
            self._course, self._latest = None, _NOTHING

    # other calls

    def _other(self, call: Exchange) -> None:
        controller = self._controller(call)
        controller.clue = better(controller.clue, clue_of_call(call))
        controller.remember(call)
        function_id, command = call.question
        refused = call.reply is not None and is_failure(call.reply.item.code)
        if function_id in _ENDS and not refused:
            self._disconnect(call, None)
        elif function_id == _ROBOT_RELEASE and not refused:
            self._disconnect(call, call.request.item.body[_HANDLE])
        elif function_id == _ROBOT_EXECUTE and command is not None and not refused:
            self._robot_call(call, command.casefold(), controller)

    def _robot_call(self, call: Exchange, command: str, controller: Controller) -> None:
        if command == "slvchangemode":
            self._change(call, controller)
        elif call.reply is not None and command in ("slvsendformat", "slvrecvformat"):
            for course in self._courses.values():
                if course.setting is None and course.conversation.server == call.conversation.server:
                    self._flush(course)
            controller.note_format(call, command)
        elif call.reply is not None and command == "slvgetmode":
            self._note_mode(call, controller)
        elif call.reply is not None:
            controller.note_position(call, command)

    def _change(self, call: Exchange, controller: Controller) -> None:
        value = mode_asked(call)
        if call.reply is None:
            controller.tried = call if value else None
            return
        key = call.conversation, call.request.item.body[_HANDLE]
        course = self._courses.get(key) or controller.waiting.get(key)
        if course is not None:
            reason = ExitReason.CHANGED if value else ExitReason.LEFT
            self._close(course, Exit(reason, _end_of(call), _frames_of(call), call.hresult, fact_of(call)))
        controller.tried = None
        controller.mode_told = (None, "")
        if value != 0:
            self._started += 1
            mode = value, "slvChangeMode"
            entered = Course(self._started, key, fact_of(call), mode, window=self._window, heed=self._heed)
            dropped = controller.wait(key, entered)
            if dropped is not None:
                self._close(dropped, Exit(ExitReason.SILENT, dropped.last_seen, (), None, None))

    def _note_mode(self, call: Exchange, controller: Controller) -> None:
        arguments = () if call.reply is None else call.reply.item.arguments
        value = mode_value(arguments[0].variant) if arguments else None
        if not value:
            return
        controller.mode_told = value, "slvGetMode"
        course = self._courses.get((call.conversation, call.request.item.body[_HANDLE]))
        if course is not None and course.mode[0] is None:
            course.mode = controller.mode_told

    def _disconnect(self, call: Exchange, handle: bytes | None) -> None:
        """End the stays of a client, or of one of its robots."""
        waiting = self._controller(call).waiting
        for course in (*self._courses.values(), *waiting.values()):
            if course.conversation is call.conversation and handle in (None, course.handle):
                reason = ExitReason.DISCONNECTED
                self._close(
                    course, Exit(reason, _end_of(call), _frames_of(call), call.hresult, fact_of(call))
                )

    # ends

    def _close(self, course: Course, exit_: Exit) -> None:
        """End a stay; where an error had ended it already, that stays the reason."""
        exit_ = self._closing.pop(course, exit_)
        controller = self._controllers.get(course.conversation.server) or Controller()
        self._courses.pop(course.key, None)
        controller.waiting.pop(course.key, None)
        self._over[course.key] = course
        if len(self._over) > MOST_STAYS:
            del self._over[next(iter(self._over))]
        if self._course is course:
            self._course, self._latest = None, _NOTHING
        setting = self._setting(course)
        course.flush(setting)
        self._ended.append(_Ended(course, exit_, setting))

    def _release(self, before: int | None) -> list[Stay]:
        """Give out the stays that ended before a moment; all where it is None."""
        stays = []
        ended = self._ended
        while ended and (before is None or ended[0].exit.time <= before or len(ended) > MOST_ENDED):
            stays.append(self._stay(ended.popleft()))
        return stays

    def _stay(self, ended: _Ended) -> Stay:
        course = ended.course
        controller = self._controllers.get(course.conversation.server) or Controller()
        exit_ = _explain(ended, controller)
        others = controller.between(course.began(exit_.time) - BEFORE_NS, exit_.time + AFTER_NS)
        return course.stay(exit_, ended.setting, tuple(map(fact_of, others[-MOST_LISTED:])))

    def _flush(self, course: Course) -> None:
        course.flush(self._setting(course))

    def _setting(self, course: Course) -> Setting:
        controller = self._controllers.get(course.conversation.server) or Controller()
        return controller.setting(course.mode)

    def _controller(self, call: Exchange) -> Controller:
        server = call.conversation.server
        controller = self._controllers.get(server)
        if controller is None:
            if len(self._controllers) >= MOST_CONTROLLERS:
                del self._controllers[next(iter(self._controllers))]
            controller = self._controllers[server] = Controller()
        return controller


class ChosenStays:
    """Finds the stays of chosen set points; what begins and ends a stay is followed all the same."""

    def __init__(self, chosen: Callable[[Exchange], bool] | None, window: int | None = None) -> None:
        """Begin.

        Args:
            chosen: tells which set points are asked for; None for all, and for stays without any as well.
            window: as of `SlaveWatcher`.
        """
        self._chosen = chosen
        self._watcher = SlaveWatcher(window)

    def take(self, call: Exchange) -> Sequence[Stay]:
        """Take in a call that settled; return the stays of which no more is to be expected."""
        chosen = self._chosen
        if chosen is None:
            return self._watcher.take(call)
        if is_set_point(call) and not chosen(call):
            return ()
        return _with_points(self._watcher.take(call))

    def finish(self, ended: int = 0) -> Sequence[Stay]:
        """Return the stays that were not given out yet; `ended` as of `SlaveWatcher`."""
        stays = self._watcher.finish(ended)
        return stays if self._chosen is None else _with_points(stays)


def _with_points(stays: Sequence[Stay]) -> Sequence[Stay]:
    return [stay for stay in stays if stay.first is not None]


def is_set_point(call: Exchange) -> bool:
    """Tell whether a call is slvMove."""
    function_id, command = call.question
    return function_id == _ROBOT_EXECUTE and command is not None and command.casefold() == "slvmove"


def _end_of(call: Exchange) -> int:
    return call.request.time if call.reply is None else call.reply.time


def _frames_of(call: Exchange) -> tuple[int, ...]:
    return (call.request.number,) if call.reply is None else (call.request.number, call.reply.number)


def _explain(ended: _Ended, controller: Controller) -> Exit:
    """Look for what ended a stay of which the set points do not tell it."""
    course, exit_, _ = ended
    if exit_.reason not in (ExitReason.FOUND_OFF, ExitReason.SILENT, ExitReason.CAPTURE_ENDED):
        return exit_
    began = course.began(exit_.time)
    last = began if course.last_accepted is None else course.last_accepted
    found_off = exit_.reason is ExitReason.FOUND_OFF
    until = exit_.time if found_off else max(exit_.time, last) + SILENCE_NS
    recent = max(began, last - DROPPING_NS, exit_.time - SUSPICION_NS)
    told = [call for call in controller.between(min(recent, last), until) if _end_of(call) <= until]
    changes = [call for call in told if _end_of(call) >= last and _leaves(call, course)]
    if changes:
        return _exit_by(ExitReason.OTHER_CLIENT, changes[-1], exit_)
    failures = [call for call in told if _end_of(call) >= recent and ends_slave_mode(call.hresult or 0)]
    return _exit_by(ExitReason.OTHER_CALL, failures[-1], exit_) if failures and found_off else exit_


def _exit_by(reason: ExitReason, call: Exchange, told: Exit) -> Exit:
    frames = (*_frames_of(call), *told.frames)
    return Exit(reason, _end_of(call), frames, call.hresult, fact_of(call))


def _leaves(call: Exchange, course: Course) -> bool:
    """Tell whether a call of another client switches slave mode off."""
    foreign = call.conversation is not course.conversation
    return foreign and call.hresult is not None and not is_failure(call.hresult) and mode_asked(call) == 0
