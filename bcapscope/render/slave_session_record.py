"""One JSON object per slave-mode session, for programs.

Fields end in their unit: `_ms`, `_hz`, `_ppm`. Times are seconds since 1970 with nine digits; missing values
are null. Names that end in `frame` or `frames` hold frame numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import TypeAlias

import orjson

from bcapscope.analysis.slave.buffer_model import BufferFacts, PredictedUnderflow
from bcapscope.analysis.slave.controller_clock import ClockFacts
from bcapscope.analysis.slave.motion_model import AxisMotion, MotionFacts, Peak
from bcapscope.analysis.slave.notable_set_points import SetPointFact
from bcapscope.analysis.slave.session_slices import SessionSlice
from bcapscope.analysis.slave.slave_session import (
    AcceptedFormat,
    CallFact,
    FrameTime,
    KnownMode,
    SessionExit,
    SetPointCounts,
    SlaveSession,
)
from bcapscope.analysis.slave.timing_model import TimingFacts
from bcapscope.analysis.statistics.distribution import DistributionSummary
from bcapscope.messages import Message
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.render.frame_record import json_text
from bcapscope.render.timestamp import epoch_text

_Object: TypeAlias = "dict[str, object]"


def slave_session_record(slave_session: SlaveSession) -> bytes:
    """Write one object, without a line end."""
    conversation = slave_session.conversation
    return orjson.dumps(
        {
            "stay": slave_session.number,
            "client": _text_fragment(str(conversation.client)),
            "server": _text_fragment(str(conversation.server)),
            "transport": conversation.transport.value,
            "robot": slave_session.robot,
            "entered": _time_fragment(slave_session.entered_at),
            "began_before_capture": slave_session.began_before_capture,
            "duration_ms": slave_session.duration_ms,
            "entry": _call_record(slave_session.entry_call),
            "mode": _mode(slave_session.mode),
            "send_format": _format(slave_session.send_format),
            "receive_format": _format(slave_session.receive_format),
            "first": _frame_record(slave_session.first_set_point),
            "last": _frame_record(slave_session.last_set_point),
            "exit": _exit(slave_session.exit),
            "set_points": _counts(slave_session.counts),
            "timing": _timing(slave_session.timing),
            "buffer": _buffer(slave_session.buffer),
            "clock": None if slave_session.clock is None else _clock(slave_session.clock),
            "motion": None if slave_session.motion is None else _motion(slave_session.motion),
            "refused_list": list(map(_set_point, slave_session.refused_set_points)),
            "forbidden_retry_frames": slave_session.forbidden_retry_frames,
            "other_calls": list(map(_call_record, slave_session.other_calls)),
            "slices": list(map(_slice, slave_session.slices)),
            "slices_left_off": slave_session.slices_left_off,
        }
    )


def distribution_object(found: DistributionSummary | None) -> _Object | None:
    """Return a distribution; each of its `bins`, if any, is a list of lower edge, upper edge and count."""
    if found is None:
        return None
    fields: _Object = {
        "count": found.count,
        "mean": json_ready_number(found.mean),
        "min": json_ready_number(found.least),
        "p50": json_ready_number(found.p50),
        "p90": json_ready_number(found.p90),
        "p99": json_ready_number(found.p99),
        "p99.9": json_ready_number(found.p999),
        "max": json_ready_number(found.most),
    }
    if found.bins:
        fields["bins"] = [(each.low, each.high, each.count) for each in found.bins]
    return fields


def json_ready_number(value: float | None) -> float | str | None:
    """Return a number; NaN and infinities as text."""
    if value is None or math.isfinite(value):
        return value
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"


def _text(message: Message | None) -> str | None:
    return None if message is None else str(message)


def _time_fragment(time: int) -> orjson.Fragment:
    return orjson.Fragment(epoch_text(time).encode("ascii"))


def _text_fragment(text: str | None) -> orjson.Fragment:
    return orjson.Fragment(json_text(text))


def _call_record(call: CallFact | None) -> _Object | None:
    if call is None:
        return None
    return {
        "call": call.call,
        "client": _text_fragment(str(call.client)),
        "function": function_name(call.function_id),
        "command": _text_fragment(call.command),
        "request_frame": call.request_frame,
        "time": _time_fragment(call.time),
        "reply_frame": call.reply_frame,
        "hresult": call.hresult,
        "hresult_name": None if call.hresult is None else hresult_name(call.hresult),
    }


def _set_point(fact: SetPointFact) -> _Object:
    return {
        "call": fact.call,
        "request_frame": fact.request_frame,
        "time": _time_fragment(fact.time),
        "reply_frame": fact.reply_frame,
        "hresult": fact.hresult,
        "hresult_name": None if fact.hresult is None else hresult_name(fact.hresult),
        "latency_ms": fact.latency_ms,
        "cycle_ms": fact.cycle_ms,
    }


def _mode(mode: KnownMode) -> _Object:
    meaning = mode.meaning
    return {
        "value": mode.value,
        "known_by": mode.known_by or None,
        "kind": None if meaning is None else meaning.kind.value,
        "pose_type": None if mode.pose_type is None else mode.pose_type.value,
        "text": None if meaning is None else meaning.text,
        "guessed": mode.guessed,
        "generation": None if mode.generation is None else mode.generation.value,
        "generation_known_by": _text(mode.generation_known_by),
    }


def _format(format_: AcceptedFormat | None) -> _Object | None:
    return None if format_ is None else format_._asdict()


def _frame_record(spot: FrameTime | None) -> _Object | None:
    return None if spot is None else {"frame": spot.frame, "time": _time_fragment(spot.time)}


def _exit(exit_: SessionExit) -> _Object:
    code = exit_.hresult
    return {
        "reason": exit_.reason.value,
        "time": _time_fragment(exit_.time),
        "frames": exit_.frames,
        "hresult": code,
        "hresult_name": None if code is None else hresult_name(code),
        "hresult_text": None if code is None else describe_hresult(code).text,
        "by": _call_record(exit_.by),
    }


def _counts(counts: SetPointCounts) -> _Object:
    refused = [
        {
            "hresult": code,
            "hresult_name": hresult_name(code),
            "hresult_text": describe_hresult(code).text,
            "count": count,
        }
        for code, count in counts.refused.items()
    ]
    return {**asdict(counts), "refused": refused, "by_retries": _by_number(counts.by_retries)}


def _by_number(counts: Mapping[int, int]) -> dict[str, int]:
    return {str(key): count for key, count in counts.items()}


def _timing(timing: TimingFacts) -> _Object:
    return {
        "cycle_ms": distribution_object(timing.cycle),
        "rate_hz": timing.rate_hz,
        "grid_ms": timing.grid_ms,
        "grid_known_by": _text(timing.grid_known_by) or "",
        "jitter_ms": distribution_object(timing.jitter),
        "on_grid": timing.on_grid,
        "skipped": timing.skipped,
        "backwards": timing.backwards,
        "latency_ms": distribution_object(timing.latency),
        "rtt_ms": distribution_object(timing.rtt),
        "deadlines": [{**each._asdict(), "name": str(each.name)} for each in timing.deadlines],
        "slowest": list(map(_set_point, timing.slowest)),
        "slack_ms": timing.slack_ms,
        "gaps": timing.gaps,
        "gap_list": list(map(_set_point, timing.gap_list)),
    }


def _buffer(buffer: BufferFacts) -> _Object:
    return {
        "slots": buffer.slots,
        "period_ms": buffer.period_ms,
        "overwrites": buffer.overwrites,
        "paces": buffer.replies_pace,
        "assumptions": list(map(str, buffer.assumptions)),
        "predicted_empty": buffer.underflows,
        "predicted_empty_in_motion": buffer.underflows_in_motion,
        "predicted_empty_list": list(map(_starved, buffer.underflow_list)),
        "perhaps_empty": buffer.possible_underflows,
        "predicted_overflows": buffer.overflows,
        "predicted_overflow_frames": buffer.overflow_frames,
        "predicted_overwritten": buffer.overwritten,
        "predicted_smallest_level": buffer.smallest_level,
        "predicted_smallest_slack_ms": buffer.smallest_slack_ms,
        "predicted_smallest_slack_frame": buffer.smallest_slack_frame,
        "predicted_levels": _by_number(buffer.levels),
        "reported_underflow_frames": buffer.reported_underflows,
        "reported_overflow_frames": buffer.reported_overflows,
        "reported_full_frames": buffer.reported_full,
    }


def _starved(each: PredictedUnderflow) -> _Object:
    return {
        "time": _time_fragment(each.time),
        "after_frame": each.last_frame,
        "before_frame": each.late_frame,
        "missing": each.missed_ticks,
        "late_ms": each.late_ms,
        "moving": each.moving,
    }


def _clock(clock: ClockFacts) -> _Object:
    return {
        "stamps": clock.stamps,
        "unit": "us" if clock.microseconds else "ms",
        "unit_known_by": str(clock.unit_known_by),
        "drift_ppm": json_ready_number(clock.drift_ppm),
        "jitter_ms": distribution_object(clock.jitter),
        "step_ms": distribution_object(clock.step),
        "missing": clock.missing,
        "repeated": clock.repeated,
        "backwards": clock.backwards,
        "wraps": clock.wraps,
    }


def _motion(motion: MotionFacts) -> _Object:
    return {
        **{field.name: getattr(motion, field.name) for field in fields(motion)},
        "axes": list(map(_axis, motion.axes)),
        "jump_list": [
            {
                "frame": jump.frame,
                "time": _time_fragment(jump.time),
                "axis": jump.axis,
                "step": json_ready_number(jump.step),
            }
            for jump in motion.jump_list
        ],
        "lag_cycles": json_ready_number(motion.lag_cycles),
        "first_distance": list(map(json_ready_number, motion.first_distance)),
        "first_distance_known_by": _text(motion.first_distance_known_by),
    }


def _axis(axis: AxisMotion) -> _Object:
    return {
        "axis": axis.name,
        "unit": axis.unit,
        "min": json_ready_number(axis.least),
        "max": json_ready_number(axis.most),
        "step": distribution_object(axis.step),
        "velocity_per_s": distribution_object(axis.velocity),
        "acceleration_per_s2": distribution_object(axis.acceleration),
        "largest_step": _peak(axis.largest_step),
        "largest_velocity_per_s": _peak(axis.largest_velocity),
        "largest_acceleration_per_s2": _peak(axis.largest_acceleration),
        "difference": distribution_object(axis.difference),
        "largest_difference": _peak(axis.largest_difference),
        "lag_cycles": json_ready_number(axis.lag_cycles),
    }


def _peak(peak: Peak | None) -> _Object | None:
    return None if peak is None else {"value": json_ready_number(peak.value), "frame": peak.frame}


def _slice(each: SessionSlice) -> _Object:
    return {
        "begin": _time_fragment(each.begin),
        "sent": each.sent,
        "retries": each.retries,
        "refused": each.refused,
        "unanswered": each.unanswered,
        "cycle_ms": distribution_object(each.cycle),
        "latency_ms": distribution_object(each.latency),
        "predicted_smallest_slack_ms": each.smallest_slack_ms,
    }
