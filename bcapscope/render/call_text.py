"""Calls for people: a line each, or the chain of a call drawn under its origin."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from bcapscope.protocol.tables.function_table import FUNCTIONS, ObjectClass, function_name
from bcapscope.protocol.tables.hresult import S_EXECUTING, describe_hresult, hresult_name, is_failure
from bcapscope.protocol.text_format import counted, display_width
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.escape import printable, quoted
from bcapscope.render.line_template import LONGEST_STRING
from bcapscope.render.timestamp import TimeFormat, timestamp_writer
from bcapscope.render.tongue import Tongue, english
from bcapscope.traffic.call import Call, CallFrame, FrameRole, StrayReply
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.handle_tracker import ServiceSession, SessionEnding, TrackedObject, requested_name
from bcapscope.traffic.observation import Direction, Flow

_MILLISECOND = 1_000_000
_PLAIN_VERDICTS = frozenset(CallVerdict[outcome.name] for outcome in Outcome)
_MAX_NAMED = 6
_BRACKETS = {True: "└─", False: "├─"}


_ROLE_WIDTH = 10


class CallRenderer:
    """Writes calls as lines or trees, in the order in which they settle."""

    def __init__(
        self,
        time_format: TimeFormat = TimeFormat.RELATIVE,
        palette: Palette = PLAIN,
        write_endpoints: Callable[[Flow], str] | None = None,
        tongue: Tongue = english,
    ) -> None:
        """Choose the looks.

        Args:
            time_format: Format of the times, such as relative or absolute.
            palette: colours.
            write_endpoints: writes who spoke to whom, harmless; addresses and transport unless given.
            tongue: of the words.
        """
        self._write_endpoints = write_endpoints or _addresses
        self._write_time = timestamp_writer(time_format)
        self._palette = palette
        self._tongue = tongue

    def set_time_origin(self, time: int) -> None:
        """Count relative times from `time`, not from the first line."""
        self._write_time(time)

    def line(self, call: Call | StrayReply, subject: TrackedObject | None = None) -> str:
        """Write one line: number, start, ends, function and command, how it ended and when, frames.

        Args:
            call: the call, or a reply that belongs to none.
            subject: the object that it was asked of, where that is known.
        """
        if isinstance(call, StrayReply):
            return self._stray_line(call)
        color = self._palette
        request = call.request
        text = (
            f"{call.number:>6} {self._write_time(request.time)} "
            f"{color.dim}{self._write_endpoints(request.flow)}{color.reset}"
            f"  {self._function_text(call.kind)}{_subject_text(call, subject)}  {self._outcome_text(call)}"
        )
        if call.latency is not None:
            text += f"  {color.number}{milliseconds(call.latency)} ms{color.reset}"
        frames = self._tongue(call_frames_text(call))
        return f"{text}{self._remarks_text(call)}  {color.dim}{frames}{color.reset}"

    def tree(self, call: Call | StrayReply, subject: TrackedObject | None = None) -> Iterator[str]:
        """Write the line of a call and under it every frame, with the time since the frame before."""
        yield self.line(call, subject)
        if isinstance(call, StrayReply):
            return
        events = call.frames
        before = call.request.time
        for event in events:
            yield f"       {_BRACKETS[event is events[-1]]} {self.event_line(event, before, call)}"
            before = event.observation.time

    def event_line(self, event: CallFrame, previous_time: int, call: Call) -> str:
        """Write a frame of a call: its role, and when it was seen.

        Args:
            event: the frame.
            previous_time: when the frame before it was seen.
            call: whose it is.
        """
        seen, color, tongue = event.observation, self._palette, self._tongue
        role = tongue(event.role)
        since, elapsed = seen.time - previous_time, seen.time - call.request.time
        frame = seen.item
        text = (
            f"{role}{' ' * (_ROLE_WIDTH - display_width(role))} {tongue('frame')} {seen.number:<6}"
            f" {tongue('serial')} {frame.serial:>5}  reserved {frame.reserved:>5}"
            f"  {color.number}+{milliseconds(since)} ms{color.reset}"
            f" {tongue('at')} {milliseconds(elapsed)} ms"
        )
        if seen.flow.direction is Direction.RESPONSE:
            text += f"  {self._result_text(frame.code)}"
        return text + (
            f"  {color.problem}{tongue('discarded')}{color.reset}" if event.role is FrameRole.LATE else ""
        )

    def _function_text(self, call_kind: CallKind) -> str:
        color = self._palette
        name = f"{color.name}{function_name(call_kind.function_id)}"
        if call_kind.command is not None:
            name += f" {printable(call_kind.command[:LONGEST_STRING])}"
        return name + color.reset

    def _outcome_text(self, call: Call) -> str:
        color = self._palette
        if call.hresult is not None:
            return self._result_text(call.hresult)
        outcome = call.outcome
        shade = color.bad if outcome is Outcome.UNANSWERED else color.dim
        return f"{shade}{self._tongue(CallVerdict[outcome.name])}{color.reset}"

    def _result_text(self, code: int) -> str:
        color = self._palette
        name = hresult_name(code)
        if is_failure(code):
            return f"{color.bad}{name} ({self._tongue(describe_hresult(code).text)}){color.reset}"
        return f"{color.dim if code == S_EXECUTING else color.good}{name}{color.reset}"

    def _remarks_text(self, call: Call) -> str:
        if call.is_plain:
            return ""
        parts = []
        if call.retries:
            parts.append(counted(call.retries, "retry", "retries"))
        if call.verdict not in _PLAIN_VERDICTS:
            parts.append(str(call.verdict))
        if call.notices:
            parts.append(f"{len(call.notices)} S_EXECUTING")
        if call.duplicates:
            parts.append(counted(len(call.duplicates), "duplicate"))
        if not call.first_attempt_seen:
            parts.append("first try not seen")
        color = self._palette
        return f"  {color.problem}{', '.join(map(self._tongue, parts))}{color.reset}" if parts else ""

    def _stray_line(self, stray: StrayReply) -> str:
        seen, color = stray.observation, self._palette
        if stray.may_answer_evicted:
            whose = "may answer a call that was not followed to the end"
        elif stray.call_number is None:
            whose = "answers no request that was seen"
        else:
            whose = f"too late for call {stray.call_number}"
        what = self._tongue(f"reply with serial {seen.item.serial} {whose}")
        frame = self._tongue(f"frame {seen.number}")
        return (
            f"{'-':>6} {self._write_time(seen.time)} "
            f"{color.dim}{self._write_endpoints(seen.flow)}{color.reset}"
            f"  {color.problem}{what}{color.reset}"
            f"  {self._result_text(seen.item.code)}  {color.dim}{frame}{color.reset}"
        )


def _addresses(flow: Flow) -> str:
    return printable(f"{flow.src_text} > {flow.dst_text} {flow.conversation.transport}")


def session_text(session: ServiceSession) -> str:
    """Say how a session ended and what it left behind."""
    conversation = session.conversation
    ending = {
        SessionEnding.STOPPED: "ended by Service_Stop",
        SessionEnding.RESTARTED: "begun anew without Service_Stop",
    }
    text = (
        f"{conversation.client} > {conversation.server}: {ending.get(session.ending, 'no Service_Stop seen')}"
    )
    if not session.unreleased:
        return text
    names = [
        f"{thing.kind} {printable(thing.name[:LONGEST_STRING]) or thing.handle}"
        for thing in session.unreleased[:_MAX_NAMED]
    ]
    more = len(session.unreleased) - len(names)
    return f"{text}; not released: {', '.join(names)}{f' and {more} more' if more else ''}"


def _subject_text(call: Call, subject: TrackedObject | None) -> str:
    """Name the object that a call was asked of, or the one that it asks for."""
    function = FUNCTIONS.get(call.kind.function_id)
    text = ""
    if subject is not None and function is not None:
        name = f" ({printable(subject.name[:LONGEST_STRING])})" if subject.name else ""
        text = f" {function.params[0].name}={subject.handle}{name}"
    if function is not None and function.creates not in (None, ObjectClass.SERVICE):
        text += f" {quoted(requested_name(call, function)[:LONGEST_STRING])}"
    return text


def milliseconds(nanoseconds: int) -> str:
    """Write a duration in milliseconds, to the microsecond."""
    return f"{nanoseconds / _MILLISECOND:.3f}"


def call_frames_text(call: Call) -> str:
    """Write the numbers of a call's frames: requests, then the replies behind an arrow."""
    asked = ",".join(str(seen.number) for seen in call.attempts)
    replies = [*call.late_replies, *call.lost_replies, *([call.reply] if call.reply else [])]
    answered = ",".join(str(seen.number) for seen in sorted(replies, key=lambda seen: seen.number))
    return f"frames {asked} > {answered}" if answered else f"frame {asked}"
