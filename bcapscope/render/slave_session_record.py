"""Slave-mode sessions as JSON, one object per session.

Names of members with a unit end in `_ms`, `_hz` or `_ppm`. Times are in seconds since 1970 with nine
decimals. Names of members that hold frame numbers end in `frame` or `frames`.
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
    conversation_object,
    json_ready,
    percentiles_object,
    result_object,
    text_fragment,
    time_fragment,
)

_Object: TypeAlias = "dict[str, object]"


def slave_session_record(slave_session: SlaveSession) -> bytes:
    options = orjson.OPT_PASSTHROUGH_DATACLASS | orjson.OPT_NON_STR_KEYS
    return orjson.dumps(slave_session, lambda value: _CONVERTERS[type(value)](value), options)


def _session(session: SlaveSession) -> _Object:
    return {"stay": session.number, **conversation_object(session.conversation), **_members(session)}


def _distribution(found: DistributionSummary) -> _Object:
    """In `bins`, each bin is a list of lower edge, upper edge and count."""
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


def _clock(clock: ClockFacts) -> _Object:
    return {
        "stamps": clock.stamps,
        "unit": "us" if clock.microseconds else "ms",
        "unit_known_by": clock.unit_known_by,
        **_members(clock),
    }


def _motion(motion: MotionFacts) -> _Object:
    return {
        **{field.name: getattr(motion, field.name) for field in fields(motion)},
        "lag_cycles": json_ready(motion.lag_cycles),
        "first_distance": json_ready(motion.first_distance),
    }


_MEMBERS: dict[type, str] = {
    AxisMotion: (
        "axis=name unit min=least max=most step velocity_per_s=velocity acceleration_per_s2=acceleration "
        "largest_step largest_velocity_per_s=largest_velocity "
        "largest_acceleration_per_s2=largest_acceleration difference largest_difference lag_cycles"
    ),
    BufferFacts: (
        "slots period_ms overwrites paces=replies_pace assumptions predicted_empty=underflows "
        "predicted_empty_in_motion=underflows_in_motion predicted_empty_list=underflow_list "
        "perhaps_empty=possible_underflows predicted_overflows=overflows "
        "predicted_overflow_frames=overflow_frames predicted_overwritten=overwritten "
        "predicted_smallest_level=smallest_level predicted_smallest_slack_ms=smallest_slack_ms "
        "predicted_smallest_slack_frame=smallest_slack_frame predicted_levels=levels "
        "reported_underflow_frames=reported_underflows reported_overflow_frames=reported_overflows "
        "reported_full_frames=reported_full"
    ),
    ClockFacts: "drift_ppm jitter_ms=jitter step_ms=step missing repeated backwards wraps",
    FrameTime: "frame @time",
    Jump: "frame @time axis step",
    Peak: "value frame",
    PredictedUnderflow: (
        "@time after_frame=last_frame before_frame=late_frame missing=missed_ticks late_ms moving"
    ),
    SessionSlice: (
        "@begin sent retries refused unanswered cycle_ms=cycle latency_ms=latency "
        "predicted_smallest_slack_ms=smallest_slack_ms"
    ),
    SetPointFact: "call request_frame @time reply_frame !hresult latency_ms cycle_ms",
    SlaveSession: (
        "robot @entered=entered_at began_before_capture duration_ms entry=entry_call mode send_format "
        "receive_format first=first_set_point last=last_set_point exit set_points=counts timing buffer clock "
        "motion refused_list=refused_set_points forbidden_retry_frames other_calls slices slices_left_off"
    ),
    TimingFacts: (
        "cycle_ms=cycle rate_hz grid_ms grid_known_by jitter_ms=jitter on_grid skipped backwards "
        "latency_ms=latency rtt_ms=rtt deadlines slowest slack_ms gaps gap_list"
    ),
}
"""JSON members of each class, in order, as ``name=attribute``, or only as the name if both are equal. ``@``
marks a time. ``!`` marks a result code, which becomes the members `hresult` and `hresult_name`."""


def _members(value: object) -> _Object:
    found: _Object = {}
    for word in _MEMBERS[type(value)].split():
        name, _, attribute = word.lstrip("@!").partition("=")
        item = getattr(value, attribute or name)
        if word.startswith("!"):
            found |= result_object(item)
        elif word.startswith("@"):
            found[name] = time_fragment(item)
        else:
            found[name] = json_ready(item) if isinstance(item, float) else item
    return found


_CONVERTERS: dict[type, Callable[[Any], object]] = {
    **dict.fromkeys(_MEMBERS, _members),
    AcceptedFormat: AcceptedFormat._asdict,
    CallFact: _call,
    ClockFacts: _clock,
    Deadline: Deadline._asdict,
    DistributionSummary: _distribution,
    KnownMode: _mode,
    Message: str,
    MotionFacts: _motion,
    SessionExit: _exit,
    SetPointCounts: _counts,
    SlaveSession: _session,
}
"""For each class that orjson cannot encode, the function that converts its objects to JSON types."""
