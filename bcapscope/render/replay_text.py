"""Replayed calls as text lines and as JSON objects."""

from __future__ import annotations

from typing import TYPE_CHECKING

import orjson

from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.protocol.retry.requester import CallTimedOut
from bcapscope.protocol.tables.command_catalogue import call_name
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.escape import printable
from bcapscope.render.reply_text import ReplyRenderer

if TYPE_CHECKING:  # not imported at run time: these modules use a clock, and `render` must not use one
    from bcapscope.replay.replay_script import ScriptCall
    from bcapscope.replay.script_player import PlayedCall


class ReplayRenderer:
    """Writes the result of each replayed call, and the recorded result if it differs."""

    def __init__(self, palette: Palette = PLAIN, words: MessageFormatter = ENGLISH_WORDS) -> None:
        self._palette = palette
        self._words = words
        self._answers = ReplyRenderer(palette, words)

    def line(self, played: PlayedCall) -> str:
        """Return the line of a replayed call: number, name, result, values, time, and differences from the
        recorded call.
        """
        color, line = self._palette, played.script_call
        name = call_name(line.kind.function_id, played.arguments)
        number = f"{color.number}{line.number:>6}{color.reset} "
        if isinstance(played.result, CallTimedOut):
            no_answer = self._words("replay.no-answer")
            text = f"{color.name}{printable(name)}{color.reset}  {color.bad}{no_answer}{color.reset}"
        else:
            settled = played.result
            text = self._answers.line(
                name, line.kind.function_id, settled.reply, settled.elapsed, settled.attempts
            )
        if played.differs:
            recorded = self._words("replay.recorded", result=self._recorded_text(line))
            return f"{number}{text}  {color.problem}{recorded}{color.reset}"
        if played.values_differ:
            text += f"  {color.dim}{self._words('replay.recorded.other-values')}{color.reset}"
        return f"{number}{text}"

    def record(self, played: PlayedCall) -> bytes:
        """Return a replayed call as a JSON object."""
        line, settled = played.script_call, played.result
        answer = None if isinstance(settled, CallTimedOut) else settled
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
                "tries": len(settled.attempts),
            }
        )

    def _recorded_text(self, line: ScriptCall) -> str:
        if line.hresult is None:
            return self._words("replay.no-answer")
        return f"{hresult_name(line.hresult)}, {self._words.text(describe_hresult(line.hresult).meaning)}"
