"""Calls for people: a line each, or the chain of a call drawn under its origin."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from bcapscope.protocol.functions import FUNCTIONS, ObjectClass, function_name
from bcapscope.protocol.hresult import S_EXECUTING, describe, hresult_name, is_failure
from bcapscope.protocol.wording import counted, display_width
from bcapscope.render.escape import printable, quoted
from bcapscope.render.moment import Clock, time_writer
from bcapscope.render.palette import PLAIN, Palette
from bcapscope.render.phrase import LONGEST_STRING
from bcapscope.render.tongue import Tongue, english
from bcapscope.traffic.exchange import Event, Exchange, Role, Stray
from bcapscope.traffic.handles import Ending, Session, Thing, name_asked
from bcapscope.traffic.observation import Direction, Flow
from bcapscope.traffic.question import Question
from bcapscope.traffic.verdict import Outcome, Verdict

_MILLISECOND = 1_000_000
_PLAIN_VERDICTS = frozenset(Verdict[outcome.name] for outcome in Outcome)
_MOST_NAMED = 6
_BRACKETS = {True: "└─", False: "├─"}


_ROLE_WIDTH = 10


class CallRenderer:
    """Writes calls as lines or trees, in the order in which they settle."""

    def __init__(
        self,
        clock: Clock = Clock.RELATIVE,
        palette: Palette = PLAIN,
        ends: Callable[[Flow], str] | None = None,
        tongue: Tongue = english,
    ) -> None:
        """Choose the looks.

        Args:
            clock: how the time is told.
            palette: colours.
            ends: writes who spoke to whom, harmless; addresses and transport unless given.
            tongue: of the words.
        """
        self._ends = ends or _addresses
        self._time = time_writer(clock)
        self._palette = palette
        self._tongue = tongue

    def begin(self, time: int) -> None:
        """Count relative times from `time`, not from the first line."""
        self._time(time)

    def line(self, call: Exchange | Stray, subject: Thing | None = None) -> str:
        """Write one line: number, start, ends, function and command, how it ended and when, frames.

        Args:
            call: the call, or a reply that belongs to none.
            subject: the object that it was asked of, where that is known.
        """
        if isinstance(call, Stray):
            return self._stray(call)
        color = self._palette
        request = call.request
        text = (
            f"{call.call:>6} {self._time(request.time)} {color.dim}{self._ends(request.flow)}{color.reset}"
            f"  {self._asked(call.question)}{_subject(call, subject)}  {self._ending(call)}"
        )
        if call.latency is not None:
            text += f"  {color.number}{milliseconds(call.latency)} ms{color.reset}"
        return f"{text}{self._troubles(call)}  {color.dim}{self._tongue(frames_text(call))}{color.reset}"

    def tree(self, call: Exchange | Stray, subject: Thing | None = None) -> Iterator[str]:
        """Write the line of a call and under it every frame, with the time since the frame before."""
        yield self.line(call, subject)
        if isinstance(call, Stray):
            return
        events = call.events
        before = call.request.time
        for event in events:
            yield f"       {_BRACKETS[event is events[-1]]} {self.event(event, before, call)}"
            before = event.seen.time

    def event(self, event: Event, before: int, call: Exchange) -> str:
        """Write a frame of a call: its role, and when it was seen.

        Args:
            event: the frame.
            before: when the frame before it was seen.
            call: whose it is.
        """
        seen, color, tongue = event.seen, self._palette, self._tongue
        role = tongue(event.role)
        since, elapsed = seen.time - before, seen.time - call.request.time
        frame = seen.item
        text = (
            f"{role}{' ' * (_ROLE_WIDTH - display_width(role))} {tongue('frame')} {seen.number:<6}"
            f" {tongue('serial')} {frame.serial:>5}  reserved {frame.reserved:>5}"
            f"  {color.number}+{milliseconds(since)} ms{color.reset}"
            f" {tongue('at')} {milliseconds(elapsed)} ms"
        )
        if seen.flow.direction is Direction.RESPONSE:
            text += f"  {self._result(frame.code)}"
        return text + (
            f"  {color.problem}{tongue('discarded')}{color.reset}" if event.role is Role.LATE else ""
        )

    def _asked(self, question: Question) -> str:
        color = self._palette
        name = f"{color.name}{function_name(question.function_id)}"
        if question.command is not None:
            name += f" {printable(question.command[:LONGEST_STRING])}"
        return name + color.reset

    def _ending(self, call: Exchange) -> str:
        color = self._palette
        if call.hresult is not None:
            return self._result(call.hresult)
        outcome = call.outcome
        shade = color.bad if outcome is Outcome.UNANSWERED else color.dim
        return f"{shade}{self._tongue(Verdict[outcome.name])}{color.reset}"

    def _result(self, code: int) -> str:
        color = self._palette
        name = hresult_name(code)
        if is_failure(code):
            return f"{color.bad}{name} ({self._tongue(describe(code).text)}){color.reset}"
        return f"{color.dim if code == S_EXECUTING else color.good}{name}{color.reset}"

    def _troubles(self, call: Exchange) -> str:
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
        if not call.origin_seen:
            parts.append("first try not seen")
        color = self._palette
        return f"  {color.problem}{', '.join(map(self._tongue, parts))}{color.reset}" if parts else ""

    def _stray(self, stray: Stray) -> str:
        seen, color = stray.seen, self._palette
        if stray.overlooked:
            whose = "may answer a call that was not followed to the end"
        elif stray.call is None:
            whose = "answers no request that was seen"
        else:
            whose = f"too late for call {stray.call}"
        what = self._tongue(f"reply with serial {seen.item.serial} {whose}")
        frame = self._tongue(f"frame {seen.number}")
        return (
            f"{'-':>6} {self._time(seen.time)} {color.dim}{self._ends(seen.flow)}{color.reset}"
            f"  {color.problem}{what}{color.reset}"
            f"  {self._result(seen.item.code)}  {color.dim}{frame}{color.reset}"
        )


def _addresses(flow: Flow) -> str:
    return printable(f"{flow.src_text} > {flow.dst_text} {flow.conversation.transport}")


def session_text(session: Session) -> str:
    """Say how a session ended and what it left behind."""
    conversation = session.conversation
    ending = {Ending.STOPPED: "ended by Service_Stop", Ending.RESTARTED: "begun anew without Service_Stop"}
    text = (
        f"{conversation.client} > {conversation.server}: {ending.get(session.ending, 'no Service_Stop seen')}"
    )
    if not session.left:
        return text
    names = [
        f"{thing.kind} {printable(thing.name[:LONGEST_STRING]) or thing.handle}"
        for thing in session.left[:_MOST_NAMED]
    ]
    more = len(session.left) - len(names)
    return f"{text}; not released: {', '.join(names)}{f' and {more} more' if more else ''}"


def _subject(call: Exchange, subject: Thing | None) -> str:
    """Name the object that a call was asked of, or the one that it asks for."""
    function = FUNCTIONS.get(call.question.function_id)
    text = ""
    if subject is not None and function is not None:
        name = f" ({printable(subject.name[:LONGEST_STRING])})" if subject.name else ""
        text = f" {function.params[0].name}={subject.handle}{name}"
    if function is not None and function.creates not in (None, ObjectClass.SERVICE):
        text += f" {quoted(name_asked(call, function)[:LONGEST_STRING])}"
    return text


def milliseconds(nanoseconds: int) -> str:
    """Write a duration in milliseconds, to the microsecond."""
    return f"{nanoseconds / _MILLISECOND:.3f}"


def frames_text(call: Exchange) -> str:
    """Write the numbers of a call's frames: requests, then the replies behind an arrow."""
    asked = ",".join(str(seen.number) for seen in call.requests)
    replies = [*call.late_replies, *call.lost_replies, *([call.reply] if call.reply else [])]
    answered = ",".join(str(seen.number) for seen in sorted(replies, key=lambda seen: seen.number))
    return f"frames {asked} > {answered}" if answered else f"frame {asked}"
