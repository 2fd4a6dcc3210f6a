"""Replies to bcapscope's own calls as text lines and as JSON objects."""

from __future__ import annotations

from functools import partial

from bcapscope.errors import Attempt
from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.messages.places import Count
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.frame_template import numbers_of_arguments
from bcapscope.protocol.tables.function_table import result_param
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.escape import printable
from bcapscope.render.frame_record import FrameRecordRenderer
from bcapscope.render.line_template import LineTemplateBuilder
from bcapscope.render.result_advice import result_text
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Observation


class ReplyRenderer:
    """Writes replies with the duration of the call and the number of retries."""

    def __init__(self, palette: Palette = PLAIN, words: MessageFormatter = ENGLISH_WORDS) -> None:
        self._palette = palette
        self._words = words
        self._records = FrameRecordRenderer()

    def line(
        self, name: str, function_id: int, reply: Frame, took_ns: int, attempts: tuple[Attempt, ...]
    ) -> str:
        """Return the line of a call: name, result, values, duration in ms, and number of retries."""
        color = self._palette
        builder = LineTemplateBuilder(f"{color.name}{printable(name)}{color.reset} ".replace("%", "%%"))
        builder.add_text(result_text(reply.code, color, self._words))
        builder.add_arguments(reply.arguments, partial(result_param, function_id))
        retries = len(attempts) - 1
        builder.add_text(f"  {color.dim}{took_ns / 1e6:.3f} ms{color.reset}")
        if retries:
            builder.add_text(f" {self._words('call.after-retries', retries=Count(retries, 'retry'))}")
        return builder.build().fill((), numbers_of_arguments(reply.arguments))

    def record(
        self, observation: Observation, call_kind: CallKind, took: int, attempts: tuple[Attempt, ...]
    ) -> bytes:
        """Return a JSON object with the members of the reply frame, the duration as `took_ms`, and the number
        of attempts as `tries`.
        """
        return b'%b,"took_ms":%b,"tries":%d}' % (
            self._records.record(observation, call_kind)[:-1],
            b"%.6f" % (took / 1e6),
            len(attempts),
        )
