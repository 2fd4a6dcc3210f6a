"""One JSON object a stay in slave mode, for programs.

Fields end in their unit: `_ms`, `_hz`, `_ppm`; moments are seconds since 1970 with nine digits; what is
missing is null. `frame`, `frames` and names that end so hold frame numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TypeAlias

import orjson

from bcapscope.analysis.buffer import Buffer, Starved
from bcapscope.analysis.clock import ClockFacts
from bcapscope.analysis.distribution import Distribution
from bcapscope.analysis.moments import SetPointFact
from bcapscope.analysis.motion import AxisMotion, Motion, Peak
from bcapscope.analysis.slices import Slice
from bcapscope.analysis.stay import Call, Counts, Exit, Format, Mode, Spot, Stay
from bcapscope.analysis.timing import Timing
from bcapscope.protocol.functions import function_name
from bcapscope.protocol.hresult import describe, hresult_name
from bcapscope.render.moment import epoch_text
from bcapscope.render.record import json_text

_Object: TypeAlias = "dict[str, object]"


def stay_record(stay: Stay) -> bytes:
    """Write one object, without a line end."""
    conversation = stay.conversation
    return orjson.dumps(
        {
            "stay": stay.number,
            "client": _text(str(conversation.client)),
            "server": _text(str(conversation.server)),
            "transport": conversation.transport.value,
            "robot": stay.robot,
            "entered": _moment(stay.entered),
            "began_before_capture": stay.began_before_capture,
            "duration_ms": stay.duration_ms,
            "entry": _call(stay.entry),
            "mode": _mode(stay.mode),
            "send_format": _format(stay.send_format),
            "receive_format": _format(stay.receive_format),
            "first": _spot(stay.first),
            "last": _spot(stay.last),
            "exit": _exit(stay.exit),
            "set_points": _counts(stay.counts),
            "timing": _timing(stay.timing),
            "buffer": _buffer(stay.buffer),
            "clock": None if stay.clock is None else _clock(stay.clock),
            "motion": None if stay.motion is None else _motion(stay.motion),
            "refused_list": list(map(_set_point, stay.refused_list)),
            "forbidden_retry_frames": stay.forbidden_retry_list,
            "other_calls": list(map(_call, stay.other_calls)),
            "slices": list(map(_slice, stay.slices)),
            "slices_left_off": stay.slices_left_off,
        }
    )


def distribution_object(found: Distribution | None) -> _Object | None:
    """Say a distribution; `bins` are lists of lower edge, upper edge and count, where there are any."""
    if found is None:
        return None
    told: _Object = {
        "count": found.count,
        "mean": number(found.mean),
        "min": number(found.least),
        "p50": number(found.p50),
        "p90": number(found.p90),
        "p99": number(found.p99),
        "p99.9": number(found.p999),
        "max": number(found.most),
    }
    if found.bins:
        told["bins"] = [(each.low, each.high, each.count) for each in found.bins]
    return told


def number(value: float | None) -> float | str | None:
    """Say a number; what is none, or has no end, as a text."""
    if value is None or math.isfinite(value):
        return value
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"


def _moment(time: int) -> orjson.Fragment:
    return orjson.Fragment(epoch_text(time).encode("ascii"))


def _text(text: str | None) -> orjson.Fragment:
    return orjson.Fragment(json_text(text))


def _call(call: Call | None) -> _Object | None:
    if call is None:
        return None
    return {
        "call": call.call,
        "client": _text(str(call.client)),
        "function": function_name(call.function_id),
        "command": _text(call.command),
        "request_frame": call.request,
        "time": _moment(call.time),
        "reply_frame": call.reply,
        "hresult": call.hresult,
        "hresult_name": None if call.hresult is None else hresult_name(call.hresult),
    }


def _set_point(fact: SetPointFact) -> _Object:
    return {
        "call": fact.call,
        "request_frame": fact.request,
        "time": _moment(fact.time),
        "reply_frame": fact.reply,
        "hresult": fact.hresult,
        "hresult_name": None if fact.hresult is None else hresult_name(fact.hresult),
        "latency_ms": fact.latency_ms,
        "cycle_ms": fact.cycle_ms,
    }


def _mode(mode: Mode) -> _Object:
    meaning = mode.meaning
    return {
        "value": mode.value,
        "known_by": mode.known_by or None,
        "kind": None if meaning is None else meaning.kind.value,
        "pose_type": None if mode.pose_type is None else mode.pose_type.value,
        "text": None if meaning is None else meaning.text,
        "guessed": mode.guessed,
        "generation": None if mode.generation is None else mode.generation.value,
        "generation_known_by": mode.generation_known_by or None,
    }


def _format(format_: Format | None) -> _Object | None:
    if format_ is None:
        return None
    return {"value": format_.value, "microseconds": format_.microseconds, "frame": format_.frame}


def _spot(spot: Spot | None) -> _Object | None:
    return None if spot is None else {"frame": spot.frame, "time": _moment(spot.time)}


def _exit(exit_: Exit) -> _Object:
    code = exit_.hresult
    return {
        "reason": exit_.reason.value,
        "time": _moment(exit_.time),
        "frames": exit_.frames,
        "hresult": code,
        "hresult_name": None if code is None else hresult_name(code),
        "hresult_text": None if code is None else describe(code).text,
        "by": _call(exit_.by),
    }


def _counts(counts: Counts) -> _Object:
    refused = [
        {
            "hresult": code,
            "hresult_name": hresult_name(code),
            "hresult_text": describe(code).text,
            "count": count,
        }
        for code, count in counts.refused.items()
    ]
    return {
        "sent": counts.sent,
        "accepted": counts.accepted,
        "refused": refused,
        "unanswered": counts.unanswered,
        "open": counts.open,
        "not_followed": counts.not_followed,
        "buffer_full": counts.buffer_full,
        "after_end": counts.after_end,
        "retries": counts.retries,
        "by_retries": _by_number(counts.by_retries),
        "retries_forbidden": counts.retries_forbidden,
        "late_replies": counts.late_replies,
        "lost_replies": counts.lost_replies,
    }


def _by_number(counts: Mapping[int, int]) -> dict[str, int]:
    return {str(key): count for key, count in counts.items()}


def _timing(timing: Timing) -> _Object:
    return {
        "cycle_ms": distribution_object(timing.cycle),
        "rate_hz": timing.rate_hz,
        "grid_ms": timing.grid_ms,
        "grid_known_by": timing.grid_known_by,
        "jitter_ms": distribution_object(timing.jitter),
        "on_grid": timing.on_grid,
        "skipped": timing.skipped,
        "backwards": timing.backwards,
        "latency_ms": distribution_object(timing.latency),
        "rtt_ms": distribution_object(timing.rtt),
        "deadlines": [each._asdict() for each in timing.deadlines],
        "slowest": list(map(_set_point, timing.slowest)),
        "slack_ms": timing.slack_ms,
        "gaps": timing.gaps,
        "gap_list": list(map(_set_point, timing.gap_list)),
    }


def _buffer(buffer: Buffer) -> _Object:
    return {
        "slots": buffer.slots,
        "period_ms": buffer.period_ms,
        "overwrites": buffer.overwrites,
        "paces": buffer.paces,
        "assumptions": buffer.assumptions,
        "predicted_empty": buffer.starved,
        "predicted_empty_in_motion": buffer.starved_moving,
        "predicted_empty_list": list(map(_starved, buffer.starved_list)),
        "perhaps_empty": buffer.maybe_starved,
        "predicted_overflows": buffer.overflows,
        "predicted_overflow_frames": buffer.overflow_list,
        "predicted_overwritten": buffer.overwritten,
        "predicted_smallest_level": buffer.smallest_level,
        "predicted_smallest_slack_ms": buffer.smallest_slack_ms,
        "predicted_smallest_slack_frame": buffer.smallest_slack_at,
        "predicted_levels": _by_number(buffer.levels),
        "reported_underflow_frames": buffer.reported_underflows,
        "reported_overflow_frames": buffer.reported_overflows,
        "reported_full_frames": buffer.reported_full,
    }


def _starved(each: Starved) -> _Object:
    return {
        "time": _moment(each.time),
        "after_frame": each.after,
        "before_frame": each.before,
        "missing": each.missing,
        "late_ms": each.late_ms,
        "moving": each.moving,
    }


def _clock(clock: ClockFacts) -> _Object:
    return {
        "stamps": clock.stamps,
        "unit": "us" if clock.microseconds else "ms",
        "unit_known_by": clock.unit_known_by,
        "drift_ppm": number(clock.drift_ppm),
        "jitter_ms": distribution_object(clock.jitter),
        "step_ms": distribution_object(clock.step),
        "missing": clock.missing,
        "repeated": clock.repeated,
        "backwards": clock.backwards,
        "wraps": clock.wraps,
    }


def _motion(motion: Motion) -> _Object:
    return {
        "read": motion.read,
        "unread": motion.unread,
        "not_finite": motion.not_finite,
        "not_finite_frames": motion.not_finite_frames,
        "pose_type_guessed": motion.guessed,
        "axes": list(map(_axis, motion.axes)),
        "returned": motion.returned,
        "repeated": motion.repeated,
        "stutters": motion.stutters,
        "stutter_frames": motion.stutter_list,
        "jumps": motion.jumps,
        "jump_list": [
            {"frame": jump.frame, "time": _moment(jump.time), "axis": jump.axis, "step": number(jump.step)}
            for jump in motion.jump_list
        ],
        "figure_changes": motion.figure_changes,
        "lag_cycles": number(motion.lag_cycles),
        "first_distance": list(map(number, motion.first_distance)),
        "first_distance_known_by": motion.first_distance_known_by or None,
        "first_distance_frames": motion.first_distance_frames,
    }


def _axis(axis: AxisMotion) -> _Object:
    return {
        "axis": axis.name,
        "unit": axis.unit,
        "min": number(axis.least),
        "max": number(axis.most),
        "step": distribution_object(axis.step),
        "velocity_per_s": distribution_object(axis.velocity),
        "acceleration_per_s2": distribution_object(axis.acceleration),
        "largest_step": _peak(axis.largest_step),
        "largest_velocity_per_s": _peak(axis.largest_velocity),
        "largest_acceleration_per_s2": _peak(axis.largest_acceleration),
        "difference": distribution_object(axis.difference),
        "largest_difference": _peak(axis.largest_difference),
        "lag_cycles": number(axis.lag_cycles),
    }


def _peak(peak: Peak | None) -> _Object | None:
    return None if peak is None else {"value": number(peak.value), "frame": peak.frame}


def _slice(each: Slice) -> _Object:
    return {
        "begin": _moment(each.begin),
        "sent": each.sent,
        "retries": each.retries,
        "refused": each.refused,
        "unanswered": each.unanswered,
        "cycle_ms": distribution_object(each.cycle),
        "latency_ms": distribution_object(each.latency),
        "predicted_smallest_slack_ms": each.smallest_slack_ms,
    }
