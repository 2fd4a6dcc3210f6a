"""A stay in slave mode for people."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from bcapscope.analysis.slave.slave_session import (
    AcceptedFormat,
    CallFact,
    ExitReason,
    KnownMode,
    SlaveSession,
)
from bcapscope.protocol.slave_mode.formats import ReceiveFormat, SendFormat
from bcapscope.protocol.slave_mode.modes import Generation
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.render.captioned import captioned_line, continued_line, frames_text, wrapped_lines
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.escape import printable
from bcapscope.render.slave_controller import buffer_lines, clock_lines
from bcapscope.render.slave_motion import motion_lines
from bcapscope.render.slave_timing import deadline_lines, slice_lines, timing_lines
from bcapscope.render.timestamp import utc_text
from bcapscope.render.tongue import Tongue, english

_REASONS = {
    ExitReason.LEFT: "left in order",
    ExitReason.CHANGED: "mode changed",
    ExitReason.ERROR: "error",
    ExitReason.OTHER_CALL: "error of another call",
    ExitReason.OTHER_CLIENT: "ended by another client",
    ExitReason.FOUND_OFF: "found off: what ended it was not seen",
    ExitReason.DISCONNECTED: "the client disconnected",
    ExitReason.SILENT: "no more set points, though the capture goes on",
    ExitReason.CAPTURE_ENDED: "the capture ended first",
}


_GOOD_EXITS = (ExitReason.LEFT, ExitReason.CHANGED, ExitReason.CAPTURE_ENDED)


def slave_session_lines(
    slave_session: SlaveSession, palette: Palette = PLAIN, tongue: Tongue = english
) -> Iterator[str]:
    """Write everything about a stay: how it came and went, its timing, buffer, clock and motion.

    Times after the first are in seconds since then.
    """
    conversation = slave_session.conversation
    ends = printable(f"{conversation.client} > {conversation.server} {conversation.transport}")
    robot = "" if slave_session.robot is None else tongue(f", robot {slave_session.robot}")
    yield f"{palette.name}{tongue(f'Stay {slave_session.number}')}{palette.reset}  {ends}{robot}"
    yield from _timeline(slave_session, palette, tongue)
    for section in (
        _sections(slave_session, palette, tongue) if slave_session.first_set_point is not None else ()
    ):
        yield ""
        yield from section


def _sections(slave_session: SlaveSession, palette: Palette, tongue: Tongue) -> Iterator[Iterator[str]]:
    yield _set_points(slave_session, palette, tongue)
    yield timing_lines(slave_session.timing, palette, tongue)
    yield deadline_lines(slave_session.timing, palette, tongue)
    yield buffer_lines(slave_session.buffer, palette, tongue)
    if slave_session.clock is not None:
        yield clock_lines(slave_session.clock, palette, tongue)
    if slave_session.motion is not None:
        yield motion_lines(slave_session.motion, palette, tongue)
    if slave_session.slices:
        yield slice_lines(slave_session, palette, tongue)


def _timeline(slave_session: SlaveSession, palette: Palette, tongue: Tongue) -> Iterator[str]:
    def since(time: int) -> str:
        return f"{(time - slave_session.entered_at) / 1e9:+.6f}"

    entry = slave_session.entry_call
    how = (
        "before the capture" if entry is None else f"{_call_text(entry)}, {frames_text(_call_frames(entry))}"
    )
    yield captioned_line(tongue("entered"), f"{utc_text(slave_session.entered_at)}  {tongue(how)}", palette)
    yield from _mode(slave_session.mode, palette, tongue)
    formats = [_format("send", slave_session.send_format), _format("receive", slave_session.receive_format)]
    yield captioned_line("formats", "; ".join(formats), palette, tongue)
    if slave_session.first_set_point is not None and slave_session.last_set_point is not None:
        for caption, fact in (
            ("first", slave_session.first_set_point),
            ("last", slave_session.last_set_point),
        ):
            frame = tongue(f"frame {fact.frame}")
            yield captioned_line(tongue(caption), f"{since(fact.time)} s  {frame}", palette)
    yield from _exit(slave_session, since, palette, tongue)


def _call_text(call: CallFact) -> str:
    name = call.command or function_name(call.function_id)
    return f"{printable(name)} by {printable(str(call.client))}"


def _call_frames(call: CallFact) -> tuple[int, ...]:
    return (call.request_frame,) if call.reply_frame is None else (call.request_frame, call.reply_frame)


def _mode(mode: KnownMode, palette: Palette, tongue: Tongue) -> Iterator[str]:
    if mode.value is None:
        yield captioned_line("mode", "not known: slvChangeMode was not seen", palette, tongue)
    else:
        told = "" if mode.known_by == "slvChangeMode" else f", by {mode.known_by}"
        yield captioned_line("mode", f"0x{mode.value:03X}{told}", palette, tongue)
        yield from wrapped_lines(
            mode.meaning.text if mode.meaning else "no mode that is known", tongue=tongue
        )
    if mode.generation is not None:
        yield captioned_line(
            "controller", f"{mode.generation}, since {mode.generation_known_by}", palette, tongue
        )
    else:
        guess = ", taken for an RC8" if mode.guessed else ""
        yield captioned_line("controller", f"of an unknown generation{guess}", palette, tongue)


def _format(which: str, format_: AcceptedFormat | None) -> str:
    if format_ is None:
        return f"{which} not seen"
    parts = _send_parts(format_) if which == "send" else _receive_parts(format_)
    text = ", ".join(parts) or "pose only"
    return f"{which} 0x{format_.value & 0xFFFFFFFF:03X} ({text}; frame {format_.frame})"


def _send_parts(format_: AcceptedFormat) -> Iterator[str]:
    form = SendFormat.parse(format_.value)
    names = {"hand I/O": form.hand_io, "mini I/O": form.mini_io, "user I/O": form.user_io}
    yield from (name for name, there in names.items() if there)
    if form.other:
        yield f"unknown bits 0x{form.other & 0xFFFFFFFF:X}"


def _receive_parts(format_: AcceptedFormat) -> Iterator[str]:
    form = ReceiveFormat.parse(format_.value, format_.microseconds)
    if form.timestamp:
        yield "time stamp in µs" if form.microseconds else "time stamp in ms"
    yield from (f"{pose} pose" for pose in form.poses)
    names = {"mini I/O": form.mini_io, "user I/O": form.user_io, "hand I/O": form.hand_io}
    yield from (name for name, there in names.items() if there)
    if form.current:
        yield "current"
    if form.other:
        yield f"unknown bits 0x{form.other & 0xFFFFFFFF:X}"


def _exit(
    slave_session: SlaveSession, since: Callable[[int], str], palette: Palette, tongue: Tongue
) -> Iterator[str]:
    exit_ = slave_session.exit
    color = palette.good if exit_.reason in _GOOD_EXITS else palette.bad
    where = f"  {tongue(frames_text(exit_.frames))}" if exit_.frames else ""
    reason = f"{color}{tongue(_REASONS[exit_.reason])}{palette.reset}"
    yield captioned_line(tongue("ended"), f"{since(exit_.time)} s{where}  {reason}", palette)
    if exit_.by is not None and exit_.reason is not ExitReason.ERROR:
        yield continued_line(_call_text(exit_.by), tongue)
    if exit_.hresult:
        yield from wrapped_lines(_result(exit_.hresult, slave_session), palette.bad, palette.reset, tongue)


def _result(code: int, slave_session: SlaveSession) -> str:
    meaning = describe_hresult(code, rc7=slave_session.mode.generation is Generation.RC7)
    doubt = " (a guess)" if meaning.is_guess else ""
    return f"{hresult_name(code)}: {meaning.text}{doubt}"


def _set_points(slave_session: SlaveSession, palette: Palette, tongue: Tongue) -> Iterator[str]:
    counts = slave_session.counts
    told = [f"{counts.sent} sent", f"{counts.accepted} accepted"]
    told += [f"{sum(counts.refused.values())} refused"] if counts.refused else []
    told += [f"{counts.unanswered} unanswered"] if counts.unanswered else []
    told += [f"{counts.open} open when the capture ended"] if counts.open else []
    told += [f"{counts.not_followed} not followed to the end"] if counts.not_followed else []
    told += [f"{counts.buffer_full} with S_BUF_FULL"] if counts.buffer_full else []
    told += [f"{counts.after_end} more refused or unanswered after the end"] if counts.after_end else []
    yield captioned_line("set points", ", ".join(told), palette, tongue)
    for code, count in sorted(counts.refused.items(), key=lambda item: -item[1]):
        frames = [fact.request_frame for fact in slave_session.refused_set_points if fact.hresult == code]
        text = f"{count} × {_result(code, slave_session)}; {frames_text(frames, count)}"
        yield from wrapped_lines(text, palette.bad, palette.reset, tongue)
    yield from _retries(slave_session, palette, tongue)


def _retries(slave_session: SlaveSession, palette: Palette, tongue: Tongue) -> Iterator[str]:
    counts = slave_session.counts
    if not counts.retries:
        yield captioned_line("retries", "none", palette, tongue)
        return
    spread = ", ".join(f"{times} × {count}" for times, count in counts.by_retries.items() if times)
    text = f"{counts.retries} (retries × set points: {spread})"
    replies = [f"{counts.late_replies} late replies"] if counts.late_replies else []
    replies += [f"{counts.lost_replies} lost replies"] if counts.lost_replies else []
    yield captioned_line("retries", "; ".join((text, *replies)), palette, tongue)
    if counts.retries_forbidden:
        why = "the newest point wins in this mode, so that they only waste bandwidth"
        frames = frames_text(slave_session.forbidden_retry_frames, counts.retries_forbidden)
        text = f"{counts.retries_forbidden} should not be: {why}; {frames}"
        yield from wrapped_lines(text, palette.problem, palette.reset, tongue)
