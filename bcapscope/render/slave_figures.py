"""The figures of a slave-mode session as text: timing, the controller's buffer and clock, and motion."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from bcapscope.analysis.slave.buffer_model import BufferFacts, PredictedUnderflow
from bcapscope.analysis.slave.controller_clock import ClockFacts
from bcapscope.analysis.slave.motion_model import AxisMotion, MotionFacts
from bcapscope.analysis.slave.session_slices import SessionSlice
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.analysis.slave.timing_model import TimingFacts
from bcapscope.analysis.statistics.distribution_summary import DistributionSummary
from bcapscope.messages import Message, MessageFormatter
from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import Count, FramePlace, Quantity, Times, frames_text
from bcapscope.protocol.text_format import display_width
from bcapscope.render.color_palette import Palette
from bcapscope.render.columns import align_columns, wrap_text
from bcapscope.render.escape import printable
from bcapscope.render.text_charts import DECADE_EDGES, edges_around, histogram

CAPTION_WIDTH = 12
TEXT_WIDTH = 62
"""A caption, a line of wrapped text and a scroll bar fit into 80 columns."""

_FRAMES_SHOWN = 8


@dataclass(frozen=True, slots=True)
class CaptionWriter:
    palette: Palette
    words: MessageFormatter

    def text(self, text: Message | str) -> str:
        """Return the escaped text of a message. Return a string unchanged; it must be escaped already."""
        return printable(self.words.text(text)) if isinstance(text, Message) else text

    def label(self, id: str, /, **places: PlaceValue) -> str:
        return self.text(Message(id, **places))

    def joined(self, messages: Iterable[Message]) -> str:
        return self.words("list.comma").join(map(self.text, messages))

    def captioned(self, caption: str, text: Message | str) -> str:
        name = self.label(f"slave.caption.{caption}")
        space = " " * (CAPTION_WIDTH - display_width(name))
        return f"  {self.palette.dim}{name}{space}{self.palette.reset}{self.text(text)}".rstrip()

    def continued(self, text: Message | str) -> str:
        return f"  {'':<{CAPTION_WIDTH}}{self.text(text)}"

    def wrapped(self, text: Message | str, color: str = "") -> Iterator[str]:
        reset = self.palette.reset if color else ""
        return (self.continued(f"{color}{line}{reset}") for line in wrap_text(self.text(text), TEXT_WIDTH))

    def table(self, rows: Sequence[Sequence[str]], alignments: str, head_rows: int = 1) -> Iterator[str]:
        for number, line in enumerate(align_columns(rows, alignments)):
            is_head = number < head_rows
            yield f"  {self.palette.dim}{line}{self.palette.reset}" if is_head else f"  {line}"


def frames_message(frames: Sequence[int], count: int | None = None) -> Message:
    """List the first 8 frame numbers, and say how many of the `count` frames are not listed."""
    shown = tuple(frames[:_FRAMES_SHOWN])
    left = (len(frames) if count is None else count) - len(shown)
    if left:
        return Message("frames.more", frames=FramePlace(shown), more=left)
    return Message("frames.one" if len(shown) == 1 else "frames.several", frames=FramePlace(shown))


_SLICE_COLUMNS = (
    *("from", "sent", "retries", "refused", "cycle-p50", "p99", "max", "latency-p99", "max", "slack"),
)


def timing_lines(timing: TimingFacts, writer: CaptionWriter) -> Iterator[str]:
    names = ("cycle", "jitter", "latency", "round-trip")
    found = (timing.cycle, timing.jitter, timing.latency, timing.rtt)
    mean, most = writer.label("slave.column.mean"), writer.label("slave.column.max")
    rows: list[tuple[str, ...]] = [("ms", mean, "p50", "p90", "p99", "p99.9", most)]
    rows += [
        (
            writer.label(f"slave.row.{name}"),
            *_cells(each.mean, each.p50, each.p90, each.p99, each.p999, each.most),
        )
        for name, each in zip(names, found, strict=True)
        if each is not None
    ]
    yield from writer.table(rows, "<>>>>>>")
    places: dict[str, PlaceValue] = {"period": Quantity(timing.grid_ms, "ms")}
    grid = Message("slave.grid.no-rate", **places)
    if timing.rate_hz is not None:
        grid = Message("slave.grid", **places, rate=Quantity(timing.rate_hz, "", 2))
    yield writer.captioned("grid", grid)
    if timing.grid_known_by is not None:
        yield from writer.wrapped(timing.grid_known_by)
    if timing.cycle is not None:
        yield from _cycle_lines(timing, timing.cycle, writer)
    if timing.latency is not None:
        yield writer.captioned("latencies", Message("slave.latencies"))
        yield from _histogram(timing.latency, DECADE_EDGES, writer)


def _cycle_lines(timing: TimingFacts, cycle: DistributionSummary, writer: CaptionWriter) -> Iterator[str]:
    yield writer.continued(writer.joined(_grid_messages(timing, cycle)))
    if timing.gaps:
        frames = frames_message([fact.request_frame for fact in timing.gap_list], timing.gaps)
        text = Message("slave.gaps", n=timing.gaps, slack=Quantity(timing.slack_ms, "ms"), frames=frames)
        yield from writer.wrapped(text, writer.palette.problem)
    yield writer.captioned("cycles", Message("slave.cycles"))
    yield from _histogram(cycle, edges_around(timing.grid_ms), writer)


def _histogram(
    distribution: DistributionSummary, edges: Sequence[float], writer: CaptionWriter
) -> Iterator[str]:
    return (f"  {line}" for line in histogram(distribution.bins, edges, writer.palette))


def _grid_messages(timing: TimingFacts, cycle: DistributionSummary) -> Iterator[Message]:
    share = Quantity(100 * timing.on_grid / cycle.count, "%", 2)
    yield Message("slave.grid.within", share=share, limit=Quantity(timing.grid_ms / 10, "ms"))
    if timing.skipped:
        limit = Quantity(timing.grid_ms * 1.5, "ms")
        yield Message("slave.grid.skipped", n=timing.skipped, limit=limit)
    if timing.backwards:
        yield Message("slave.grid.backwards", n=timing.backwards)


def deadline_lines(timing: TimingFacts, writer: CaptionWriter) -> Iterator[str]:
    """Yield a table of timeouts, with the number of set points that would have exceeded each timeout."""
    rows = [tuple(map(writer.label, ("slave.timeouts", "slave.timeouts.one", "slave.timeouts.all")))]
    for deadline in timing.deadlines:
        name = ("* " if deadline.applies else "  ") + writer.text(deadline.name)
        rows.append((name, str(deadline.late), str(deadline.given_up)))
    yield from writer.table(rows, "<>>")
    sources = dict.fromkeys(deadline.source for deadline in timing.deadlines if deadline.applies)
    if sources:
        yield from writer.wrapped(Message("slave.timeouts.recommended", sources="; ".join(sources)))


def slice_lines(slave_session: SlaveSession, writer: CaptionWriter) -> Iterator[str]:
    """Yield a table with the figures of each time slice of the session; times are in ms."""
    header = tuple(writer.label(f"slave.column.{name}") for name in _SLICE_COLUMNS)
    rows = [header, *(_slice(each, slave_session.slices[0].begin) for each in slave_session.slices)]
    yield from writer.table(rows, ">" * len(header))
    if slave_session.slices_left_off:
        left_off = Count(slave_session.slices_left_off, "more-slice")
        yield f"  {writer.label('slave.slices.more', slices=left_off)}"


def _slice(each: SessionSlice, begin: int) -> tuple[str, ...]:
    cycle, latency = each.cycle, each.latency
    return (
        f"+{(each.begin - begin) / 1e9:g}",
        str(each.sent),
        str(each.retries or ""),
        str(each.refused or ""),
        *(("", "", "") if cycle is None else _cells(cycle.p50, cycle.p99, cycle.most)),
        *(("", "") if latency is None else _cells(latency.p99, latency.most)),
        "" if each.smallest_slack_ms is None else f"{each.smallest_slack_ms:.3f}",
    )


def _cells(*values: float) -> tuple[str, ...]:
    return tuple(f"{value:.3f}" for value in values)


_MAX_UNDERFLOWS_SHOWN = 8
_MOTION = {True: "moving", False: "standing", None: "unknown"}


def buffer_lines(buffer: BufferFacts, writer: CaptionWriter) -> Iterator[str]:
    """Describe the estimated level of the buffer, and the buffer errors that the controller reported."""
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


def motion_lines(motion: MotionFacts, writer: CaptionWriter) -> Iterator[str]:
    """Describe the motion of each axis, and how the returned pose differs from the commanded one."""
    case = ".guessed" if motion.pose_type_guessed else ""
    yield writer.captioned("motion", Message(f"slave.motion{case}", poses=Count(motion.read, "pose")))
    if motion.unread:
        yield writer.continued(Message("slave.motion.unread", n=motion.unread))
    if motion.not_finite:
        frames = frames_message(motion.not_finite_frames, motion.not_finite)
        text = Message("slave.motion.not-finite", n=motion.not_finite, frames=frames)
        yield from writer.wrapped(text, writer.palette.problem)
    yield from _axes([axis for axis in motion.axes if axis.name != "Fig"], writer)
    yield from _oddities(motion, writer)


_AXIS_HEADER = (
    ("", "least", "most", "step", "at-frame", "velocity", "", "acceleration", "", "off", "", "lag"),
    ("", "", "", "max", "", "p99", "max", "p99", "max", "p99", "max", "cycles"),
)
"""Message ids of the two heading rows, without the prefix ``slave.column.``."""


def _axes(axes: Sequence[AxisMotion], writer: CaptionWriter) -> Iterator[str]:
    moving = [axis for axis in axes if axis.least != axis.most]
    if not moving:
        if axes:
            yield writer.continued(Message("slave.motion.none"))
        return
    head = [
        tuple(writer.label(f"slave.column.{name}") if name else "" for name in row) for row in _AXIS_HEADER
    ]
    rows = (_axis(each, writer.words) for each in moving)
    yield from writer.table([*head, *rows], "<" + ">" * (len(head[0]) - 1), len(head))
    still = [axis.name for axis in axes if axis.least == axis.most]
    if still:
        yield writer.continued(Message("slave.motion.still", axes=" ".join(still)))
    yield from writer.wrapped(Message("slave.motion.units"))


def _axis(axis: AxisMotion, words: MessageFormatter) -> tuple[str, ...]:
    unit = f" {axis.unit}" if axis.unit else ""
    step = axis.largest_step
    return (
        f"{axis.name}{unit}",
        _short_number(axis.least),
        _short_number(axis.most),
        *(("", "") if step is None else (_short_number(step.value), frames_text((step.frame,), words))),
        *_p99_and_max(axis.velocity),
        *_p99_and_max(axis.acceleration),
        *_p99_and_max(axis.difference),
        "" if axis.lag_cycles is None else f"{axis.lag_cycles:.1f}",
    )


def _p99_and_max(found: DistributionSummary | None) -> tuple[str, str]:
    return ("", "") if found is None else (_short_number(found.p99), _short_number(found.most))


def _short_number(value: float) -> str:
    if value and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.1e}"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def _oddities(motion: MotionFacts, writer: CaptionWriter) -> Iterator[str]:
    if motion.first_distance and motion.first_distance_known_by is not None:
        yield from writer.wrapped(_first_point_message(motion, motion.first_distance_known_by))
    if motion.repeated:
        points: dict[str, PlaceValue] = {"points": Count(motion.repeated, "set-point")}
        text = Message("slave.motion.repeated", **points)
        if motion.stutters:
            frames = frames_message(motion.stutter_frames, motion.stutters)
            text = Message(
                "slave.motion.repeated.stutters", **points, stutters=motion.stutters, frames=frames
            )
        yield from writer.wrapped(text)
    if motion.jumps:
        first = motion.jump_list[0]
        text = Message(
            "slave.motion.jumps",
            steps=Count(motion.jumps, "step"),
            step=Quantity(first.step),
            axis=first.axis,
            frames=frames_message([jump.frame for jump in motion.jump_list], motion.jumps),
        )
        yield from writer.wrapped(text, writer.palette.problem)
    if motion.figure_changes:
        yield writer.continued(Message("slave.motion.figure", times=Times(motion.figure_changes)))


def _first_point_message(motion: MotionFacts, known_by: Message) -> Message:
    farthest, axis = max(
        zip(motion.first_distance, motion.axes, strict=False),
        key=lambda pair: abs(pair[0]),
        default=(0.0, None),
    )
    if axis is None:
        return Message("slave.motion.first", distance=Quantity(abs(farthest)), known_by=known_by)
    distance = Quantity(abs(farthest), axis.unit)
    return Message("slave.motion.first.axis", distance=distance, axis=axis.name, known_by=known_by)
