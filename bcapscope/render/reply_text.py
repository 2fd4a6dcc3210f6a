"""Text lines and JSON objects for the replies to bcapscope's own calls, and for replayed calls."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import orjson

from bcapscope.errors import Attempt
from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.messages.places import Count
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.frame_template import numbers_of_arguments
from bcapscope.protocol.retry.requester import CallTimedOut
from bcapscope.protocol.tables.command_catalogue import call_name
from bcapscope.protocol.tables.function_table import function_name, result_param
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.escape import printable
from bcapscope.render.frame_line import LineTemplateBuilder
from bcapscope.render.frame_record import FrameRecordRenderer
from bcapscope.render.result_advice import result_text
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Observation

if TYPE_CHECKING:  # not imported at run time: these modules use a clock, and `render` must not use one
    from bcapscope.replay.script_player import PlayedCall


def reply_line(
    name: str,
    function_id: int,
    reply: Frame,
    took_ns: int,
    attempts: tuple[Attempt, ...],
    *,
    palette: Palette = PLAIN,
    words: MessageFormatter = ENGLISH_WORDS,
) -> str:
    builder = LineTemplateBuilder(f"{palette.name}{printable(name)}{palette.reset} ".replace("%", "%%"))
    builder.add_text(result_text(reply.code, palette, words))
    builder.add_arguments(reply.arguments, partial(result_param, function_id))
    retries = len(attempts) - 1
    builder.add_text(f"  {palette.dim}{took_ns / 1e6:.3f} ms{palette.reset}")
    if retries:
        builder.add_text(f" {words('call.after-retries', retries=Count(retries, 'retry'))}")
    return builder.build().fill((), numbers_of_arguments(reply.arguments))


def reply_record(
    observation: Observation, call_kind: CallKind, took_ns: int, attempts: tuple[Attempt, ...]
) -> bytes:
    """Return the JSON of the reply frame. `took_ms` is the duration, `tries` the number of attempts."""
    record = FrameRecordRenderer().record(observation, call_kind)
    return b'%b,"took_ms":%.6f,"tries":%d}' % (record[:-1], took_ns / 1e6, len(attempts))


def replayed_line(
    played: PlayedCall, palette: Palette = PLAIN, words: MessageFormatter = ENGLISH_WORDS
) -> str:
    """Return one line with the number and the reply of a call, and differences from the recorded call."""
    line, result = played.script_call, played.result
    name, function_id = call_name(line.kind.function_id, played.arguments), line.kind.function_id
    no_answer = words("replay.no-answer")
    if isinstance(result, CallTimedOut):
        text = f"{palette.name}{printable(name)}{palette.reset}  {palette.bad}{no_answer}{palette.reset}"
    else:
        given = name, function_id, result.reply, result.elapsed, result.attempts
        text = reply_line(*given, palette=palette, words=words)
    text = f"{palette.number}{line.number:>6}{palette.reset} {text}"
    if played.differs:
        recorded = no_answer
        if line.hresult is not None:
            meaning = words.text(describe_hresult(line.hresult).meaning)
            recorded = f"{hresult_name(line.hresult)}, {meaning}"
        return f"{text}  {palette.problem}{words('replay.recorded', result=recorded)}{palette.reset}"
    if played.values_differ:
        return f"{text}  {palette.dim}{words('replay.recorded.other-values')}{palette.reset}"
    return text


def replayed_record(played: PlayedCall) -> bytes:
    line, result = played.script_call, played.result
    answer = None if isinstance(result, CallTimedOut) else result
    return orjson.dumps(
        {
            "call": line.number,
            "function": function_name(line.kind.function_id),
            "function_id": line.kind.function_id,
            "command": None if line.kind.command is None else printable(line.kind.command),
            "recorded_hresult": line.hresult,
            "hresult": answer.reply.code if answer else None,
            "differs": played.differs,
            "other_values": played.values_differ,
            "late_ms": played.delay / 1e6,
            "took_ms": answer.elapsed / 1e6 if answer else None,
            "recorded_ms": None if line.hresult is None else line.duration / 1e6,
            "tries": len(result.attempts),
        }
    )
