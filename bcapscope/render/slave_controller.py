"""The controller's buffer and clock during a stay, for people."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.analysis.slave.buffer_model import BufferFacts
from bcapscope.analysis.slave.controller_clock import ClockFacts
from bcapscope.protocol.text_format import counted
from bcapscope.render.captioned import captioned_line, continued_line, frames_text, times_text, wrapped_lines
from bcapscope.render.color_palette import Palette
from bcapscope.render.tongue import Tongue, english

_MAX_UNDERFLOWS_SHOWN = 8


def buffer_lines(buffer: BufferFacts, palette: Palette, tongue: Tongue = english) -> Iterator[str]:
    """Write what a model predicts of the buffer, and what the controller reported."""
    slots = counted(buffer.slots, "slot")
    yield captioned_line("buffer", f"{slots}; levels are predicted, by a model", palette, tongue)
    for assumption in buffer.assumptions:
        yield from wrapped_lines(f"- {tongue(assumption)}")
    if buffer.smallest_slack_ms is not None:
        levels = ", ".join(f"{level} × {count}" for level, count in buffer.levels.items())
        text = f"points that a set point found there × set points: {levels}"
        yield captioned_line("level", text, palette, tongue)
        at = f"frame {buffer.smallest_slack_frame}"
        yield captioned_line(
            "slack", f"{buffer.smallest_slack_ms:.3f} ms at the least, {at}", palette, tongue
        )
    yield from _underflow_lines(buffer, palette, tongue)
    if buffer.overwritten:
        yield continued_line(
            f"{buffer.overwritten} set points replaced before they were taken, as predicted", tongue
        )
    if buffer.overflows:
        frames = frames_text(buffer.overflow_frames, buffer.overflows)
        yield captioned_line(
            "too full", f"predicted {times_text(buffer.overflows)}; {frames}", palette, tongue
        )
    reported = {"underflow": buffer.reported_underflows, "overflow": buffer.reported_overflows}
    for caption, found in reported.items():
        if found:
            who, frames = tongue("reported by the controller"), tongue(frames_text(found))
            yield captioned_line(tongue(caption), f"{palette.bad}{who}{palette.reset}  {frames}", palette)


def _underflow_lines(buffer: BufferFacts, palette: Palette, tongue: Tongue) -> Iterator[str]:
    if not buffer.underflows and not buffer.possible_underflows:
        yield captioned_line("empty", "never, as predicted", palette, tongue)
        return
    told = f"predicted {times_text(buffer.underflows)}, {buffer.underflows_in_motion} of it in motion"
    doubt = f"; perhaps {times_text(buffer.possible_underflows)} more" if buffer.possible_underflows else ""
    held = ", where the last point is held" if buffer.overwrites else ""
    yield captioned_line("empty", told + held + doubt, palette, tongue)
    for each in buffer.underflow_list[:_MAX_UNDERFLOWS_SHOWN]:
        moving = {True: "moving", False: "standing", None: "motion not known"}[each.moving]
        color = palette.problem if each.moving is not False and not buffer.overwrites else ""
        late = f"frame {each.late_frame} came {each.late_ms:.3f} ms too late"
        text = f"after frame {each.last_frame}: {late}, {moving}"
        yield continued_line(f"{color}{tongue(text)}{palette.reset if color else ''}")
    if buffer.underflows > _MAX_UNDERFLOWS_SHOWN:
        yield continued_line(f"and {buffer.underflows - _MAX_UNDERFLOWS_SHOWN} more", tongue)


def clock_lines(clock: ClockFacts, palette: Palette, tongue: Tongue = english) -> Iterator[str]:
    """Write how the controller's time stamps go with the clock of the capture."""
    unit = "µs" if clock.microseconds else "ms"
    text = f"{clock.stamps} time stamps in {unit}, as {clock.unit_known_by} tells"
    yield captioned_line("clock", text, palette, tongue)
    if clock.drift_ppm is not None:
        faster = "faster" if clock.drift_ppm >= 0 else "slower"
        yield continued_line(
            f"the controller's is {abs(clock.drift_ppm):.1f} ppm {faster} than the capture's", tongue
        )
    if clock.jitter is not None:
        text = f"p50 {clock.jitter.p50:.3f}, p99 {clock.jitter.p99:.3f}, max {clock.jitter.most:.3f} ms"
        yield continued_line(f"delay of replies changes by {text}", tongue)
    counts = {
        "periods without a stamp": clock.missing,
        "stamps repeated": clock.repeated,
        "stamps backwards": clock.backwards,
        "wraps of the 32-bit number": clock.wraps,
    }
    told = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    yield continued_line(told or "no stamp missing", tongue)
