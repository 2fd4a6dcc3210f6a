"""The answer to a call that we made: a line for people, an object for programs."""

from __future__ import annotations

from functools import partial

from bcapscope.errors import Attempt
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.hresult import describe, hresult_name, is_failure
from bcapscope.protocol.layout import flatten
from bcapscope.protocol.roles import result_role
from bcapscope.protocol.wording import counted
from bcapscope.render.escape import printable
from bcapscope.render.palette import PLAIN, Palette
from bcapscope.render.phrase import PhraseBuilder
from bcapscope.render.record import RecordRenderer
from bcapscope.render.tongue import Tongue, english
from bcapscope.traffic.observation import Observation
from bcapscope.traffic.question import Question


class AnswerRenderer:
    """Writes answers, with the time that they took and the tries that were needed."""

    def __init__(self, palette: Palette = PLAIN, tongue: Tongue = english) -> None:
        self._palette = palette
        self._tongue = tongue
        self._records = RecordRenderer()

    def line(
        self, name: str, function_id: int, reply: Frame, took: int, attempts: tuple[Attempt, ...]
    ) -> str:
        """Write a line: call, result, values, ms, retries.

        Args:
            name: of the call, such as `Robot_Execute slvMove`.
            function_id: of the call.
            reply: as it came.
            took: nanoseconds from the first try.
            attempts: all tries.
        """
        color = self._palette
        builder = PhraseBuilder(f"{color.name}{printable(name)}{color.reset} ".replace("%", "%%"))
        result = hresult_name(reply.code)
        if is_failure(reply.code):
            builder.text(f"{color.bad}{result} ({self._tongue(describe(reply.code).text)}){color.reset}")
        else:
            builder.text(f"{color.good}{result}{color.reset}")
        builder.arguments(reply.arguments, partial(result_role, function_id))
        retries = len(attempts) - 1
        builder.text(f"  {color.dim}{took / 1e6:.3f} ms{color.reset}")
        if retries:
            tries = f"after {counted(retries, 'retry', 'retries')}"
            builder.text(f" {self._tongue(tries)}")
        return builder.done().fill((), flatten(reply.arguments))

    def record(
        self, seen: Observation, question: Question, took: int, attempts: tuple[Attempt, ...]
    ) -> bytes:
        """Write a JSON object: the reply as frames are written, then `took_ms` and `tries`."""
        return b'%b,"took_ms":%b,"tries":%d}' % (
            self._records.record(seen, question)[:-1],
            b"%.6f" % (took / 1e6),
            len(attempts),
        )
