"""Calls as text: one line per call, or a tree of the call's frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache

from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.messages.places import Count, frames_text, origins_text
from bcapscope.protocol.tables.function_table import FUNCTIONS, ObjectClass, function_name
from bcapscope.protocol.text_format import display_width, shortened
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.escape import printable, quoted
from bcapscope.render.frame_line import LONGEST_STRING
from bcapscope.render.result_advice import result_text
from bcapscope.render.timestamp import TimeFormat, timestamp_writer
from bcapscope.traffic.call import Call, CallFrame, FrameRole, StrayReply
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.call_verdict import CallVerdict, Outcome
from bcapscope.traffic.handle_tracker import ServiceSession, SessionEnding, TrackedObject, requested_name
from bcapscope.traffic.joining.joined_observation import JoinedObservation
from bcapscope.traffic.observation import Direction, Flow

_MILLISECOND = 1_000_000
_PLAIN_VERDICTS = frozenset(CallVerdict[outcome.name] for outcome in Outcome)
_MAX_NAMED = 6
_MAX_RESULTS = 1024  # maximum number of result codes whose texts are cached
_ROLE_WIDTH = 10


class CallRenderer:
    """Writes calls as lines or trees. Relative times count from the first line."""

    def __init__(
        self,
        time_format: TimeFormat = TimeFormat.RELATIVE,
        palette: Palette = PLAIN,
        write_endpoints: Callable[[Flow], str] | None = None,
        words: MessageFormatter = ENGLISH_WORDS,
    ) -> None:
        """`write_endpoints` returns escaped text. By default, lines show addresses and transport."""
        self._write_endpoints = write_endpoints or _addresses
        self._write_time = timestamp_writer(time_format)
        self._palette = palette
        self._words = words
        # Look up these texts of the message catalogue only once, so that the lines of many calls print fast.
        self._roles = {role: words(f"frame.role.{role.replace(' ', '-')}") for role in FrameRole}
        self._labels = {name: words(f"call.label.{name}") for name in ("frame", "serial", "reserved", "at")}
        self._frame_text = words("call.frame", requests="{0}")
        self._frames_text = words("call.frames", requests="{0}", replies="{1}")
        self._result_text = lru_cache(_MAX_RESULTS)(lambda code: result_text(code, palette, words))

    def set_time_origin(self, time: int) -> None:
        """Count relative times from `time` (ns since 1970) instead of from the first line."""
        self._write_time(time)

    def line(self, call: Call | StrayReply, subject: TrackedObject | None = None) -> str:
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
        return f"{text}{self._remarks_text(call)}  {color.dim}{self._call_frames(call)}{color.reset}"

    def tree(self, call: Call | StrayReply, subject: TrackedObject | None = None) -> Iterator[str]:
        """Yield the line of a call, then one line per frame with the time since the previous frame."""
        yield self.line(call, subject)
        if isinstance(call, StrayReply):
            return
        events = call.frames
        before = call.request.time
        for event in events:
            yield f"       {'└─' if event is events[-1] else '├─'} {self.event_line(event, before, call)}"
            before = event.observation.time

    def event_line(self, event: CallFrame, previous_time: int, call: Call) -> str:
        """Return the line of one frame in a call's tree; `previous_time` is in ns since 1970."""
        seen, color, labels = event.observation, self._palette, self._labels
        role = self._roles[event.role]
        since, elapsed = seen.time - previous_time, seen.time - call.request.time
        frame = seen.item
        text = (
            f"{role}{' ' * (_ROLE_WIDTH - display_width(role))} {labels['frame']} {seen.number:<6}"
            f" {labels['serial']} {frame.serial:>5}  {labels['reserved']} {frame.reserved:>5}"
            f"  {color.number}+{milliseconds(since)} ms{color.reset}"
            f" {labels['at']} {milliseconds(elapsed)} ms"
        )
        if seen.flow.direction is Direction.RESPONSE:
            text += f"  {self._result_text(frame.code)}"
        if isinstance(seen, JoinedObservation):
            text += self._place_text(seen)
        if event.role is FrameRole.LATE:
            text += f"  {color.problem}{self._words('call.discarded')}{color.reset}"
        return text

    def _place_text(self, seen: JoinedObservation) -> str:
        """Say how long the frame took from one place to the other, or that it was lost between them."""
        color, delay = self._palette, seen.delay
        if seen.was_lost_between:
            case = "proxy" if seen.is_relayed else "between"
            return f"  {color.problem}{self._words(f'call.lost.{case}')}{color.reset}"
        if delay is None:
            return ""
        error = f" \N{PLUS-MINUS SIGN} {milliseconds(seen.delay_error)}" if seen.delay_error else ""
        case = "proxy" if seen.is_relayed else "one-way"
        return f"  {self._words(f'call.delay.{case}', time=f'{milliseconds(delay)}{error}')}"

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
        return f"{shade}{self._verdict(CallVerdict[outcome.name])}{color.reset}"

    def _verdict(self, verdict: CallVerdict) -> str:
        return self._words(f"call.verdict.{verdict.replace(' ', '-')}")

    def _call_frames(self, call: Call) -> str:
        if call.is_plain and call.reply is not None and self._words.find_frame is None:  # nearly all calls
            return self._frames_text.format(call.request.number, call.reply.number)
        requests = ",".join(str(seen.number) for seen in call.attempts)
        replies = [*call.late_replies, *call.lost_replies, *([call.reply] if call.reply else [])]
        if not replies:
            return self._located(self._frame_text.format(requests), call)
        numbers = sorted(seen.number for seen in replies)
        return self._located(self._frames_text.format(requests, ",".join(map(str, numbers))), call)

    def _located(self, frames: str, call: Call) -> str:
        origins = origins_text((event.observation.number for event in call.frames), self._words)
        return f"{frames} ({origins})" if origins else frames

    def _remarks_text(self, call: Call) -> str:
        if call.is_plain and not isinstance(call.request, JoinedObservation):
            return ""
        parts, words = [], self._words
        retries, unseen = call.retries + call.unseen_retries, call.unseen_retries
        if unseen:
            parts.append(words("call.unseen-retries", retries=Count(retries, "retry"), unseen=unseen))
        elif retries:
            parts.append(words.plural("count.retry", retries))
        if call.verdict not in _PLAIN_VERDICTS:
            parts.append(self._verdict(call.verdict))
        parts += self._place_remarks(call)
        if call.notices:
            parts.append(words("call.notices", n=len(call.notices)))
        if call.duplicates:
            parts.append(words.plural("count.duplicate", len(call.duplicates)))
        if not call.first_attempt_seen:
            parts.append(words("call.first-attempt-not-seen"))
        color = self._palette
        return f"  {color.problem}{words('list.comma').join(parts)}{color.reset}" if parts else ""

    def _place_remarks(self, call: Call) -> Iterator[str]:
        words, lost = self._words, call.lost_between
        if lost:
            case = "proxy" if lost[0].is_relayed else "between"
            yield words(f"call.lost.{case}")
        notes = dict.fromkeys(seen.note for seen in call.joined_frames if seen.note)
        yield from (printable(shortened(note, LONGEST_STRING)) for note in notes)
        held = max((seen.held_by_proxy for seen in call.joined_frames), default=0)
        if held >= _MILLISECOND:
            yield words("call.held", time=milliseconds(held))

    def _stray_line(self, stray: StrayReply) -> str:
        seen, color = stray.observation, self._palette
        serial = seen.item.serial
        if stray.may_answer_evicted:
            what = self._words("call.stray.evicted", serial=serial)
        elif stray.call_number is None:
            what = self._words("call.stray", serial=serial)
        else:
            what = self._words("call.stray.late", serial=serial, call=stray.call_number)
        frame = self._frame_text.format(frames_text((seen.number,), self._words))
        return (
            f"{'-':>6} {self._write_time(seen.time)} "
            f"{color.dim}{self._write_endpoints(seen.flow)}{color.reset}"
            f"  {color.problem}{what}{color.reset}"
            f"  {self._result_text(seen.item.code)}  {color.dim}{frame}{color.reset}"
        )


def _addresses(flow: Flow) -> str:
    return printable(f"{flow.src_text} > {flow.dst_text} {flow.conversation.transport}")


def session_text(session: ServiceSession, words: MessageFormatter = ENGLISH_WORDS) -> str:
    return printable(words.text(_session_message(session)))


def _session_message(session: ServiceSession) -> Message:
    conversation = session.conversation
    client, server = str(conversation.client), str(conversation.server)
    ending = "unseen" if session.ending is SessionEnding.OPEN else session.ending
    end = Message(f"session.ended.{ending}", client=client, server=server)
    if not session.unreleased:
        return end
    objects = ", ".join(
        f"{each.kind} {each.name[:LONGEST_STRING] or each.handle}" for each in session.unreleased[:_MAX_NAMED]
    )
    more = len(session.unreleased) - _MAX_NAMED
    if more <= 0:
        return Message("session.unreleased", end=end, objects=objects)
    return Message("session.unreleased.more", end=end, objects=objects, more=more)


def _subject_text(call: Call, subject: TrackedObject | None) -> str:
    function = FUNCTIONS.get(call.kind.function_id)
    text = ""
    if subject is not None and function is not None:
        name = f" ({printable(subject.name[:LONGEST_STRING])})" if subject.name else ""
        text = f" {function.params[0].name}={subject.handle}{name}"
    if function is not None and function.creates not in (None, ObjectClass.SERVICE):
        text += f" {quoted(requested_name(call, function)[:LONGEST_STRING])}"
    return text


def milliseconds(nanoseconds: int) -> str:
    return f"{nanoseconds / _MILLISECOND:.3f}"
