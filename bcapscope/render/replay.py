"""What came of calls that were made again after a recording: a line for people, an object for programs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import orjson

from bcapscope.protocol.commands import call_name
from bcapscope.protocol.functions import function_name
from bcapscope.protocol.hresult import describe, hresult_name
from bcapscope.protocol.requester import TimedOut
from bcapscope.render.answer import AnswerRenderer
from bcapscope.render.escape import printable
from bcapscope.render.palette import PLAIN, Palette

if TYPE_CHECKING:  # what makes calls reads a clock, and nothing here does
    from bcapscope.replay.performance import Played
    from bcapscope.replay.script import Line


class ReplayRenderer:
    """Writes calls as they were answered now, and beside that what was recorded where it is another thing."""

    def __init__(self, palette: Palette = PLAIN) -> None:
        self._palette = palette
        self._answers = AnswerRenderer(palette)

    def line(self, played: Played) -> str:
        """Write a line: number, call, result, values, time, and what differs from the recording."""
        color, line = self._palette, played.line
        name = call_name(line.question.function_id, played.arguments)
        number = f"{color.number}{line.call:>6}{color.reset} "
        if isinstance(played.settled, TimedOut):
            text = f"{color.name}{printable(name)}{color.reset}  {color.bad}no answer{color.reset}"
        else:
            settled = played.settled
            text = self._answers.line(
                name, line.question.function_id, settled.reply, settled.took, settled.attempts
            )
        if played.differs:
            return f"{number}{text}  {color.problem}recorded: {_recorded(line)}{color.reset}"
        return f"{number}{text}{f'  {color.dim}recorded: other values{color.reset}' if played.moved else ''}"

    def record(self, played: Played) -> bytes:
        """Write a JSON object."""
        line, settled = played.line, played.settled
        answer = None if isinstance(settled, TimedOut) else settled
        return orjson.dumps(
            {
                "call": line.call,
                "function": function_name(line.question.function_id),
                "function_id": line.question.function_id,
                "command": None if line.question.command is None else printable(line.question.command),
                "recorded_hresult": line.hresult,
                "hresult": answer.reply.code if answer else None,
                "differs": played.differs,
                "other_values": played.moved,
                "late_ms": played.late / 1e6,
                "took_ms": answer.took / 1e6 if answer else None,
                "recorded_ms": None if line.hresult is None else line.took / 1e6,
                "tries": len(settled.attempts),
            }
        )


def _recorded(line: Line) -> str:
    if line.hresult is None:
        return "no answer"
    return f"{hresult_name(line.hresult)}, {describe(line.hresult).text}"
