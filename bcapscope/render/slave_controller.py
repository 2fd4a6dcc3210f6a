"""The controller's buffer and clock during a slave-mode session as text."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.analysis.slave.buffer_model import BufferFacts, PredictedUnderflow
from bcapscope.analysis.slave.controller_clock import ClockFacts
from bcapscope.messages import Message
from bcapscope.messages.places import Count, FramePlace, Quantity, Times
from bcapscope.render.captioned import CaptionWriter, frames_message

_MAX_UNDERFLOWS_SHOWN = 8
_MOTION = {True: "moving", False: "standing", None: "unknown"}


def buffer_lines(buffer: BufferFacts, writer: CaptionWriter) -> Iterator[str]:
    """Yield the lines about the buffer: its level estimated by a model, and errors that the controller
    reported.
    """
    yield writer.captioned("buffer", Message("slave.buffer", slots=Count(buffer.slots, "slot")))
    for assumption in buffer.assumptions:
        yield from writer.wrapped(f"- {writer.text(assumption)}")
    if buffer.smallest_slack_ms is not None and buffer.smallest_slack_frame is not None:
        levels = ", ".join(f"{level} × {count}" for level, count in buffer.levels.items())
        yield writer.captioned("level", Message("slave.buffer.levels", levels=levels))
        slack, frame = Quantity(buffer.smallest_slack_ms, "ms", 3), FramePlace((buffer.smallest_slack_frame,))
        yield writer.captioned("slack", Message("slave.buffer.slack", slack=slack, frame=frame))
    yield from _underflow_lines(buffer, writer)
    if buffer.overwritten:
        yield writer.continued(
            Message("slave.buffer.overwritten", points=Count(buffer.overwritten, "set-point"))
        )
    if buffer.overflows:
        frames = frames_message(buffer.overflow_frames, buffer.overflows)
        text = Message("slave.buffer.overflow", times=Times(buffer.overflows), frames=frames)
        yield writer.captioned("too-full", text)
    for caption, found in (
        ("underflow", buffer.reported_underflows),
        ("overflow", buffer.reported_overflows),
    ):
        if found:
            who = f"{writer.palette.bad}{writer.label('slave.buffer.reported')}{writer.palette.reset}"
            yield writer.captioned(caption, f"{who}  {writer.text(frames_message(found))}")


def _underflow_lines(buffer: BufferFacts, writer: CaptionWriter) -> Iterator[str]:
    if not buffer.underflows and not buffer.possible_underflows:
        yield writer.captioned("empty", Message("slave.buffer.never-empty"))
        return
    parts = [
        Message(
            f"slave.buffer.empty{'.held' if buffer.overwrites else ''}",
            times=Times(buffer.underflows),
            moving=buffer.underflows_in_motion,
        )
    ]
    if buffer.possible_underflows:
        parts.append(Message("slave.buffer.empty.perhaps", times=Times(buffer.possible_underflows)))
    yield writer.captioned("empty", writer.joined(parts))
    for each in buffer.underflow_list[:_MAX_UNDERFLOWS_SHOWN]:
        color = writer.palette.problem if each.moving is not False and not buffer.overwrites else ""
        text = writer.text(_underflow_message(each))
        yield writer.continued(f"{color}{text}{writer.palette.reset if color else ''}")
    if buffer.underflows > _MAX_UNDERFLOWS_SHOWN:
        yield writer.continued(Message("slave.more", n=buffer.underflows - _MAX_UNDERFLOWS_SHOWN))


def _underflow_message(underflow: PredictedUnderflow) -> Message:
    return Message(
        f"slave.buffer.underflow.{_MOTION[underflow.moving]}",
        last=FramePlace((underflow.last_frame,)),
        frame=FramePlace((underflow.late_frame,)),
        late=Quantity(underflow.late_ms, "ms", 3),
    )


def clock_lines(clock: ClockFacts, writer: CaptionWriter) -> Iterator[str]:
    """Yield the lines that compare the controller's time stamps with the clock of the capture."""
    text = Message(
        "slave.clock",
        stamps=Count(clock.stamps, "time-stamp"),
        unit="µs" if clock.microseconds else "ms",
        source=clock.unit_known_by,
    )
    yield writer.captioned("clock", text)
    if clock.drift_ppm is not None:
        case = "faster" if clock.drift_ppm >= 0 else "slower"
        drift = Quantity(abs(clock.drift_ppm), "ppm", 1)
        yield writer.continued(Message(f"slave.clock.{case}", drift=drift))
    if clock.jitter is not None:
        text = Message(
            "slave.clock.jitter",
            p50=Quantity(clock.jitter.p50, "", 3),
            p99=Quantity(clock.jitter.p99, "", 3),
            most=Quantity(clock.jitter.most, "ms", 3),
        )
        yield writer.continued(text)
    counts = {
        "stamp-missing": clock.missing,
        "stamp-repeated": clock.repeated,
        "stamp-backwards": clock.backwards,
        "stamp-wrap": clock.wraps,
    }
    parts = [Count(n, unit).text(writer.words) for unit, n in counts.items() if n]
    yield writer.continued(writer.words("list.comma").join(parts) or Message("slave.clock.complete"))
