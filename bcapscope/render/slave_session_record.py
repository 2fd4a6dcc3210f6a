"""Slave-mode sessions as JSON, one object per session.

Names of JSON members with a unit end in `_ms`, `_hz` or `_ppm`. Times are in seconds since 1970 with nine
decimals. Missing values are null. JSON members whose names end in `frame` or `frames` hold frame numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, fields
from typing import Any, TypeAlias

import orjson

from bcapscope.analysis.slave.buffer_model import BufferFacts, PredictedUnderflow
from bcapscope.analysis.slave.controller_clock import ClockFacts
from bcapscope.analysis.slave.motion_model import AxisMotion, Jump, MotionFacts, Peak
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
from bcapscope.analysis.slave.timing_model import Deadline, TimingFacts
from bcapscope.analysis.statistics.distribution_summary import DistributionSummary
from bcapscope.messages import Message
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import describe_hresult
from bcapscope.render.json_values import (
    json_ready,
    percentiles_object,
    result_object,
    text_fragment,
    time_fragment,
)

_Object: TypeAlias = "dict[str, object]"


def slave_session_record(slave_session: SlaveSession) -> bytes:
    """Return a slave-mode session as one JSON object, without a line end."""
    options = orjson.OPT_PASSTHROUGH_DATACLASS | orjson.OPT_NON_STR_KEYS
    return orjson.dumps(slave_session, lambda value: _CONVERTERS[type(value)](value), options)


def _session(session: SlaveSession) -> _Object:
    conversation = session.conversation
    return {
        "stay": session.number,
        "client": text_fragment(str(conversation.client)),
        "server": text_fragment(str(conversation.server)),
        "transport": conversation.transport,
        "robot": session.robot,
        "entered": time_fragment(session.entered_at),
        "began_before_capture": session.began_before_capture,
        "duration_ms": session.duration_ms,
        "entry": session.entry_call,
        "mode": session.mode,
        "send_format": session.send_format,
        "receive_format": session.receive_format,
        "first": session.first_set_point,
        "last": session.last_set_point,
        "exit": session.exit,
        "set_points": session.counts,
        "timing": session.timing,
        "buffer": session.buffer,
        "clock": session.clock,
        "motion": session.motion,
        "refused_list": session.refused_set_points,
        "forbidden_retry_frames": session.forbidden_retry_frames,
        "other_calls": session.other_calls,
        "slices": session.slices,
        "slices_left_off": session.slices_left_off,
    }


def _distribution(found: DistributionSummary) -> _Object:
    """Return the JSON members of a distribution.

    In `bins`, each bin is a list of lower edge, upper edge and count.
    """
    bins = {"bins": [(each.low, each.high, each.count) for each in found.bins]} if found.bins else {}
    return {"count": found.count, **percentiles_object(found), **bins}


def _call(call: CallFact) -> _Object:
    return {
        "call": call.call,
        "client": text_fragment(str(call.client)),
        "function": function_name(call.function_id),
        "command": text_fragment(call.command),
        "request_frame": call.request_frame,
        "time": time_fragment(call.time),
        "reply_frame": call.reply_frame,
        **result_object(call.hresult),
    }


def _set_point(fact: SetPointFact) -> _Object:
    return {
        "call": fact.call,
        "request_frame": fact.request_frame,
        "time": time_fragment(fact.time),
        "reply_frame": fact.reply_frame,
        **result_object(fact.hresult),
        "latency_ms": fact.latency_ms,
        "cycle_ms": fact.cycle_ms,
    }


def _mode(mode: KnownMode) -> _Object:
    meaning = mode.meaning
    return {
        "value": mode.value,
        "known_by": mode.known_by or None,
        "kind": None if meaning is None else meaning.kind,
        "pose_type": mode.pose_type,
        "text": None if meaning is None else meaning.text,
        "guessed": mode.guessed,
        "generation": mode.generation,
        "generation_known_by": mode.generation_known_by,
    }


def _exit(exit_: SessionExit) -> _Object:
    code = exit_.hresult
    return {
        "reason": exit_.reason,
        "time": time_fragment(exit_.time),
        "frames": exit_.frames,
        **result_object(code),
        "hresult_text": None if code is None else describe_hresult(code).text,
        "by": exit_.by,
    }


def _counts(counts: SetPointCounts) -> _Object:
    refused = [
        {**result_object(code), "hresult_text": describe_hresult(code).text, "count": count}
        for code, count in counts.refused.items()
    ]
    return {**asdict(counts), "refused": refused}


def _timing(timing: TimingFacts) -> _Object:
    return {
        "cycle_ms": timing.cycle,
        "rate_hz": timing.rate_hz,
        "grid_ms": timing.grid_ms,
        "grid_known_by": timing.grid_known_by or "",
        "jitter_ms": timing.jitter,
        "on_grid": timing.on_grid,
        "skipped": timing.skipped,
        "backwards": timing.backwards,
        "latency_ms": timing.latency,
        "rtt_ms": timing.rtt,
        "deadlines": timing.deadlines,
        "slowest": timing.slowest,
        "slack_ms": timing.slack_ms,
        "gaps": timing.gaps,
        "gap_list": timing.gap_list,
    }


def _buffer(buffer: BufferFacts) -> _Object:
    return {
        "slots": buffer.slots,
        "period_ms": buffer.period_ms,
        "overwrites": buffer.overwrites,
        "paces": buffer.replies_pace,
        "assumptions": buffer.assumptions,
        "predicted_empty": buffer.underflows,
        "predicted_empty_in_motion": buffer.underflows_in_motion,
        "predicted_empty_list": buffer.underflow_list,
        "perhaps_empty": buffer.possible_underflows,
        "predicted_overflows": buffer.overflows,
        "predicted_overflow_frames": buffer.overflow_frames,
        "predicted_overwritten": buffer.overwritten,
        "predicted_smallest_level": buffer.smallest_level,
        "predicted_smallest_slack_ms": buffer.smallest_slack_ms,
        "predicted_smallest_slack_frame": buffer.smallest_slack_frame,
        "predicted_levels": buffer.levels,
        "reported_underflow_frames": buffer.reported_underflows,
        "reported_overflow_frames": buffer.reported_overflows,
        "reported_full_frames": buffer.reported_full,
    }


def _underflow(each: PredictedUnderflow) -> _Object:
    return {
        "time": time_fragment(each.time),
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
        "unit_known_by": clock.unit_known_by,
        "drift_ppm": json_ready(clock.drift_ppm),
        "jitter_ms": clock.jitter,
        "step_ms": clock.step,
        "missing": clock.missing,
        "repeated": clock.repeated,
        "backwards": clock.backwards,
        "wraps": clock.wraps,
    }


def _motion(motion: MotionFacts) -> _Object:
    return {
        **{field.name: getattr(motion, field.name) for field in fields(motion)},
        "lag_cycles": json_ready(motion.lag_cycles),
        "first_distance": json_ready(motion.first_distance),
    }


def _jump(jump: Jump) -> _Object:
    time, step = time_fragment(jump.time), json_ready(jump.step)
    return {"frame": jump.frame, "time": time, "axis": jump.axis, "step": step}


def _axis(axis: AxisMotion) -> _Object:
    return {
        "axis": axis.name,
        "unit": axis.unit,
        "min": json_ready(axis.least),
        "max": json_ready(axis.most),
        "step": axis.step,
        "velocity_per_s": axis.velocity,
        "acceleration_per_s2": axis.acceleration,
        "largest_step": axis.largest_step,
        "largest_velocity_per_s": axis.largest_velocity,
        "largest_acceleration_per_s2": axis.largest_acceleration,
        "difference": axis.difference,
        "largest_difference": axis.largest_difference,
        "lag_cycles": json_ready(axis.lag_cycles),
    }


def _slice(each: SessionSlice) -> _Object:
    return {
        "begin": time_fragment(each.begin),
        "sent": each.sent,
        "retries": each.retries,
        "refused": each.refused,
        "unanswered": each.unanswered,
        "cycle_ms": each.cycle,
        "latency_ms": each.latency,
        "predicted_smallest_slack_ms": each.smallest_slack_ms,
    }


_CONVERTERS: dict[type, Callable[[Any], object]] = {
    AcceptedFormat: AcceptedFormat._asdict,
    AxisMotion: _axis,
    BufferFacts: _buffer,
    CallFact: _call,
    ClockFacts: _clock,
    Deadline: Deadline._asdict,
    DistributionSummary: _distribution,
    FrameTime: lambda spot: {"frame": spot.frame, "time": time_fragment(spot.time)},
    Jump: _jump,
    KnownMode: _mode,
    Message: str,
    MotionFacts: _motion,
    Peak: lambda peak: {"value": json_ready(peak.value), "frame": peak.frame},
    PredictedUnderflow: _underflow,
    SessionExit: _exit,
    SessionSlice: _slice,
    SetPointCounts: _counts,
    SetPointFact: _set_point,
    SlaveSession: _session,
    TimingFacts: _timing,
}
"""Functions that convert each class to JSON types. orjson calls them for classes that it cannot encode."""
