"""A slave-mode session as text."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.analysis.slave.slave_session import (
    AcceptedFormat,
    CallFact,
    ExitReason,
    KnownMode,
    SlaveSession,
)
from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import CallPlace, Count, FramePlace, HexNumber, Listing
from bcapscope.protocol.slave_mode.formats import ReceiveFormat, SendFormat
from bcapscope.protocol.slave_mode.modes import Generation
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.slave_figures import (
    CaptionWriter,
    buffer_lines,
    clock_lines,
    deadline_lines,
    frames_message,
    motion_lines,
    slice_lines,
    timing_lines,
)
from bcapscope.render.timestamp import utc_text

GOOD_EXITS = (ExitReason.LEFT, ExitReason.CHANGED, ExitReason.CAPTURE_ENDED)
"""Normal reasons for the end of a slave-mode session."""


def slave_session_lines(
    slave_session: SlaveSession, palette: Palette = PLAIN, words: MessageFormatter = ENGLISH_WORDS
) -> Iterator[str]:
    """Yield all lines. The entry time is in UTC; all other times are in seconds since the entry."""
    writer = CaptionWriter(palette, words)
    conversation = slave_session.conversation
    ends: dict[str, PlaceValue] = {
        "client": str(conversation.client),
        "server": str(conversation.server),
        "transport": conversation.transport.value,
    }
    line = Message("slave.ends", **ends)
    if slave_session.robot is not None:
        line = Message("slave.ends.robot", **ends, robot=slave_session.robot)
    title = writer.label("slave.title", number=slave_session.number)
    yield f"{palette.name}{title}{palette.reset}  {writer.text(line)}"
    yield from _timeline(slave_session, writer)
    for section in _sections(slave_session, writer) if slave_session.first_set_point is not None else ():
        yield ""
        yield from section


def _sections(slave_session: SlaveSession, writer: CaptionWriter) -> Iterator[Iterator[str]]:
    yield _set_points(slave_session, writer)
    yield timing_lines(slave_session.timing, writer)
    yield deadline_lines(slave_session.timing, writer)
    yield buffer_lines(slave_session.buffer, writer)
    if slave_session.clock is not None:
        yield clock_lines(slave_session.clock, writer)
    if slave_session.motion is not None:
        yield motion_lines(slave_session.motion, writer)
    if slave_session.slices:
        yield slice_lines(slave_session, writer)


def _timeline(slave_session: SlaveSession, writer: CaptionWriter) -> Iterator[str]:
    entry = slave_session.entry_call
    how = Message("slave.entered.before")
    if entry is not None:
        frames = frames_message(
            [each for each in (entry.request_frame, entry.reply_frame) if each is not None]
        )
        how = Message("slave.entered", call=_call_place(entry), client=str(entry.client), frames=frames)
    yield writer.captioned("entered", f"{utc_text(slave_session.entered_at)}  {writer.text(how)}")
    yield from _mode(slave_session.mode, writer)
    yield writer.captioned("formats", _send_message(slave_session.send_format))
    yield writer.continued(_receive_message(slave_session.receive_format))
    for caption, fact in (
        ("first", slave_session.first_set_point),
        ("last", slave_session.last_set_point),
    ):
        if fact is not None:
            frame = writer.text(frames_message((fact.frame,)))
            yield writer.captioned(caption, f"{_since_entry(slave_session, fact.time)}  {frame}")
    yield from _exit(slave_session, writer)


def _since_entry(slave_session: SlaveSession, time: int) -> str:
    return f"{(time - slave_session.entered_at) / 1e9:+.6f} s"


def _call_place(call: CallFact) -> CallPlace:
    return CallPlace(call.command or function_name(call.function_id), None, call.call)


def _mode(mode: KnownMode, writer: CaptionWriter) -> Iterator[str]:
    if mode.value is None:
        yield writer.captioned("mode", Message("slave.mode.unknown"))
    else:
        number = HexNumber(mode.value, 3)
        direct = mode.known_by == "slvChangeMode"
        source = Message("slave.mode.from", mode=number, command=mode.known_by)
        yield writer.captioned("mode", number.text(writer.words) if direct else source)
        meaning = Message("slave.mode.undefined") if mode.meaning is None else mode.meaning.description
        yield from writer.wrapped(meaning)
    if mode.generation is not None and mode.generation_known_by is not None:
        text = Message("slave.controller", generation=mode.generation.value, reason=mode.generation_known_by)
    else:
        text = Message(f"slave.controller.{'guessed' if mode.guessed else 'unknown'}")
    yield writer.captioned("controller", text)


def _send_message(format_: AcceptedFormat | None) -> Message:
    if format_ is None:
        return Message("slave.format.send.none")
    form = SendFormat.parse(format_.value)
    has = {"hand-io": form.hand_io, "mini-io": form.mini_io, "user-io": form.user_io}
    return _format_message("send", format_, [], has, form.other)


def _receive_message(format_: AcceptedFormat | None) -> Message:
    if format_ is None:
        return Message("slave.format.receive.none")
    form = ReceiveFormat.parse(format_.value, format_.microseconds)
    parts = [_part(f"stamp-{'us' if form.microseconds else 'ms'}")] if form.timestamp else []
    parts += [_part("pose", pose=pose.value) for pose in form.poses]
    has = {"mini-io": form.mini_io, "user-io": form.user_io, "hand-io": form.hand_io, "current": form.current}
    return _format_message("receive", format_, parts, has, form.other)


def _format_message(
    which: str, format_: AcceptedFormat, parts: list[Message], has: dict[str, bool], other: int
) -> Message:
    parts += [_part(name) for name, there in has.items() if there]
    if other:
        parts.append(_part("unknown", bits=HexNumber(other & 0xFFFFFFFF, 1)))
    return Message(
        f"slave.format.{which}",
        value=HexNumber(format_.value & 0xFFFFFFFF, 3),
        parts=Listing(tuple(parts or [_part("pose-only")])),
        frame=FramePlace((format_.frame,)),
    )


def _part(name: str, **places: PlaceValue) -> Message:
    return Message(f"slave.format.part.{name}", **places)


def _exit(slave_session: SlaveSession, writer: CaptionWriter) -> Iterator[str]:
    exit_, palette = slave_session.exit, writer.palette
    color = palette.good if exit_.reason in GOOD_EXITS else palette.bad
    where = f"  {writer.text(frames_message(exit_.frames))}" if exit_.frames else ""
    reason = writer.text(exit_message(exit_.reason))
    time = _since_entry(slave_session, exit_.time)
    yield writer.captioned("ended", f"{time}{where}  {color}{reason}{palette.reset}")
    if exit_.by is not None and exit_.reason is not ExitReason.ERROR:
        yield writer.continued(
            Message("slave.ended-by", call=_call_place(exit_.by), client=str(exit_.by.client))
        )
    if exit_.hresult:
        yield from writer.wrapped(exit_result_message(exit_.hresult, slave_session), palette.bad)


def exit_message(reason: ExitReason) -> Message:
    return Message(f"slave.exit.{reason.replace(' ', '-')}")


def exit_result_message(code: int, slave_session: SlaveSession) -> Message:
    """Return a result code with its meaning, which depends on the controller of the session."""
    info = describe_hresult(code, rc7=slave_session.mode.generation is Generation.RC7)
    case = ".guess" if info.is_guess else ""
    return Message(f"slave.result{case}", code=hresult_name(code), meaning=info.meaning)


def _set_points(slave_session: SlaveSession, writer: CaptionWriter) -> Iterator[str]:
    counts = slave_session.counts
    optional = {
        "refused": sum(counts.refused.values()),
        "unanswered": counts.unanswered,
        "open": counts.open,
        "not-followed": counts.not_followed,
        "not-captured": counts.not_captured,
        "buffer-full": counts.buffer_full,
        "after-end": counts.after_end,
    }
    shown = {"sent": counts.sent, "accepted": counts.accepted}
    shown |= {name: count for name, count in optional.items() if count}
    parts = [Message(f"slave.points.{name}", n=count) for name, count in shown.items()]
    yield writer.captioned("set-points", writer.joined(parts))
    for code, count in sorted(counts.refused.items(), key=lambda item: -item[1]):
        frames = [fact.request_frame for fact in slave_session.refused_set_points if fact.hresult == code]
        text = Message(
            "slave.points.refused-with",
            n=count,
            result=exit_result_message(code, slave_session),
            frames=frames_message(frames, count),
        )
        yield from writer.wrapped(text, writer.palette.bad)
    yield from _retries(slave_session, writer)


def _retries(slave_session: SlaveSession, writer: CaptionWriter) -> Iterator[str]:
    counts = slave_session.counts
    if not counts.retries:
        yield writer.captioned("retries", Message("slave.retries.none"))
        return
    spread = ", ".join(f"{times} × {count}" for times, count in counts.by_retries.items() if times)
    parts = [writer.label("slave.retries", n=counts.retries, spread=spread)]
    for unit, count in (("late-reply", counts.late_replies), ("lost-reply", counts.lost_replies)):
        if count:
            parts.append(Count(count, unit).text(writer.words))
    yield writer.captioned("retries", writer.words("list.comma").join(parts))
    if counts.retries_forbidden:
        frames = frames_message(slave_session.forbidden_retry_frames, counts.retries_forbidden)
        text = Message("slave.retries.superfluous", n=counts.retries_forbidden, frames=frames)
        yield from writer.wrapped(text, writer.palette.problem)
