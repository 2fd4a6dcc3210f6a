"""A stay in slave mode for people."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from bcapscope.analysis.stay import Call, ExitReason, Format, Mode, Stay
from bcapscope.protocol.functions import function_name
from bcapscope.protocol.hresult import describe, hresult_name
from bcapscope.protocol.slaveformat import ReceiveFormat, SendFormat
from bcapscope.protocol.slavemode import Generation
from bcapscope.render.captioned import captioned, frames_text, more, wrapped
from bcapscope.render.escape import printable
from bcapscope.render.moment import utc_text
from bcapscope.render.palette import PLAIN, Palette
from bcapscope.render.slave_controller import buffer_lines, clock_lines
from bcapscope.render.slave_motion import motion_lines
from bcapscope.render.slave_timing import deadline_lines, slice_lines, timing_lines
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


_QUIET = (ExitReason.LEFT, ExitReason.CHANGED, ExitReason.CAPTURE_ENDED)


def stay_lines(stay: Stay, palette: Palette = PLAIN, tongue: Tongue = english) -> Iterator[str]:
    """Write everything about a stay: how it came and went, its timing, buffer, clock and motion.

    Times after the first are in seconds since then.
    """
    conversation = stay.conversation
    ends = printable(f"{conversation.client} > {conversation.server} {conversation.transport}")
    robot = "" if stay.robot is None else tongue(f", robot {stay.robot}")
    yield f"{palette.name}{tongue(f'Stay {stay.number}')}{palette.reset}  {ends}{robot}"
    yield from _timeline(stay, palette, tongue)
    for section in _sections(stay, palette, tongue) if stay.first is not None else ():
        yield ""
        yield from section


def _sections(stay: Stay, palette: Palette, tongue: Tongue) -> Iterator[Iterator[str]]:
    yield _set_points(stay, palette, tongue)
    yield timing_lines(stay.timing, palette, tongue)
    yield deadline_lines(stay.timing, palette, tongue)
    yield buffer_lines(stay.buffer, palette, tongue)
    if stay.clock is not None:
        yield clock_lines(stay.clock, palette, tongue)
    if stay.motion is not None:
        yield motion_lines(stay.motion, palette, tongue)
    if stay.slices:
        yield slice_lines(stay, palette, tongue)


def _timeline(stay: Stay, palette: Palette, tongue: Tongue) -> Iterator[str]:
    def since(time: int) -> str:
        return f"{(time - stay.entered) / 1e9:+.6f}"

    entry = stay.entry
    how = "before the capture" if entry is None else f"{_asked(entry)}, {frames_text(_call_frames(entry))}"
    yield captioned(tongue("entered"), f"{utc_text(stay.entered)}  {tongue(how)}", palette)
    yield from _mode(stay.mode, palette, tongue)
    formats = [_format("send", stay.send_format), _format("receive", stay.receive_format)]
    yield captioned("formats", "; ".join(formats), palette, tongue)
    if stay.first is not None and stay.last is not None:
        for caption, fact in (("first", stay.first), ("last", stay.last)):
            frame = tongue(f"frame {fact.frame}")
            yield captioned(tongue(caption), f"{since(fact.time)} s  {frame}", palette)
    yield from _exit(stay, since, palette, tongue)


def _asked(call: Call) -> str:
    name = call.command or function_name(call.function_id)
    return f"{printable(name)} by {printable(str(call.client))}"


def _call_frames(call: Call) -> tuple[int, ...]:
    return (call.request,) if call.reply is None else (call.request, call.reply)


def _mode(mode: Mode, palette: Palette, tongue: Tongue) -> Iterator[str]:
    if mode.value is None:
        yield captioned("mode", "not known: slvChangeMode was not seen", palette, tongue)
    else:
        told = "" if mode.known_by == "slvChangeMode" else f", by {mode.known_by}"
        yield captioned("mode", f"0x{mode.value:03X}{told}", palette, tongue)
        yield from wrapped(mode.meaning.text if mode.meaning else "no mode that is known", tongue=tongue)
    if mode.generation is not None:
        yield captioned("controller", f"{mode.generation}, since {mode.generation_known_by}", palette, tongue)
    else:
        guess = ", taken for an RC8" if mode.guessed else ""
        yield captioned("controller", f"of an unknown generation{guess}", palette, tongue)


def _format(which: str, format_: Format | None) -> str:
    if format_ is None:
        return f"{which} not seen"
    parts = _send_parts(format_) if which == "send" else _receive_parts(format_)
    text = ", ".join(parts) or "pose only"
    return f"{which} 0x{format_.value & 0xFFFFFFFF:03X} ({text}; frame {format_.frame})"


def _send_parts(format_: Format) -> Iterator[str]:
    form = SendFormat.parse(format_.value)
    names = {"hand I/O": form.hand_io, "mini I/O": form.mini_io, "user I/O": form.user_io}
    yield from (name for name, there in names.items() if there)
    if form.other:
        yield f"unknown bits 0x{form.other & 0xFFFFFFFF:X}"


def _receive_parts(format_: Format) -> Iterator[str]:
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


def _exit(stay: Stay, since: Callable[[int], str], palette: Palette, tongue: Tongue) -> Iterator[str]:
    exit_ = stay.exit
    color = palette.good if exit_.reason in _QUIET else palette.bad
    where = f"  {tongue(frames_text(exit_.frames))}" if exit_.frames else ""
    reason = f"{color}{tongue(_REASONS[exit_.reason])}{palette.reset}"
    yield captioned(tongue("ended"), f"{since(exit_.time)} s{where}  {reason}", palette)
    if exit_.by is not None and exit_.reason is not ExitReason.ERROR:
        yield more(_asked(exit_.by), tongue)
    if exit_.hresult:
        yield from wrapped(_result(exit_.hresult, stay), palette.bad, palette.reset, tongue)


def _result(code: int, stay: Stay) -> str:
    meaning = describe(code, rc7=stay.mode.generation is Generation.RC7)
    doubt = " (a guess)" if meaning.guess else ""
    return f"{hresult_name(code)}: {meaning.text}{doubt}"


def _set_points(stay: Stay, palette: Palette, tongue: Tongue) -> Iterator[str]:
    counts = stay.counts
    told = [f"{counts.sent} sent", f"{counts.accepted} accepted"]
    told += [f"{sum(counts.refused.values())} refused"] if counts.refused else []
    told += [f"{counts.unanswered} unanswered"] if counts.unanswered else []
    told += [f"{counts.open} open when the capture ended"] if counts.open else []
    told += [f"{counts.not_followed} not followed to the end"] if counts.not_followed else []
    told += [f"{counts.buffer_full} with S_BUF_FULL"] if counts.buffer_full else []
    told += [f"{counts.after_end} more refused or unanswered after the end"] if counts.after_end else []
    yield captioned("set points", ", ".join(told), palette, tongue)
    for code, count in sorted(counts.refused.items(), key=lambda item: -item[1]):
        frames = [fact.request for fact in stay.refused_list if fact.hresult == code]
        text = f"{count} × {_result(code, stay)}; {frames_text(frames, count)}"
        yield from wrapped(text, palette.bad, palette.reset, tongue)
    yield from _retries(stay, palette, tongue)


def _retries(stay: Stay, palette: Palette, tongue: Tongue) -> Iterator[str]:
    counts = stay.counts
    if not counts.retries:
        yield captioned("retries", "none", palette, tongue)
        return
    spread = ", ".join(f"{times} × {count}" for times, count in counts.by_retries.items() if times)
    text = f"{counts.retries} (retries × set points: {spread})"
    replies = [f"{counts.late_replies} late replies"] if counts.late_replies else []
    replies += [f"{counts.lost_replies} lost replies"] if counts.lost_replies else []
    yield captioned("retries", "; ".join((text, *replies)), palette, tongue)
    if counts.retries_forbidden:
        why = "the newest point wins in this mode, so that they only waste bandwidth"
        frames = frames_text(stay.forbidden_retry_list, counts.retries_forbidden)
        text = f"{counts.retries_forbidden} should not be: {why}; {frames}"
        yield from wrapped(text, palette.problem, palette.reset, tongue)
