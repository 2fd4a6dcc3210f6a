"""One line a frame, for people."""

from __future__ import annotations

from functools import partial

from bcapscope.protocol.frame import Frame, Malformed
from bcapscope.protocol.functions import function_name
from bcapscope.protocol.hresult import S_EXECUTING, describe, hresult_name, is_failure
from bcapscope.protocol.layout import Layout, flatten
from bcapscope.render.escape import printable
from bcapscope.render.moment import Clock, time_writer
from bcapscope.render.palette import PLAIN, Palette
from bcapscope.render.phrase import Phrase, PhraseBuilder
from bcapscope.render.roles import request_role, result_role
from bcapscope.traffic.observation import Direction, Flow, Observation
from bcapscope.traffic.question import Question, question_of

MOST_PHRASES = 4096
"""Phrases and flow texts kept; when there are more, all are forgotten and made again."""

LONGEST_RAW = 48
"""Bytes of a malformed item that its line shows."""


_REQUEST = Direction.REQUEST


class LineRenderer:
    """Writes frames as lines, in the order in which they were seen."""

    def __init__(self, clock: Clock = Clock.RELATIVE, palette: Palette = PLAIN) -> None:
        self._palette = palette
        self._phrases: dict[tuple[Layout, Question | None, bool], Phrase] = {}
        self._ends: dict[Flow, str] = {}
        self._time = time_writer(clock)

    def line(self, seen: Observation, question: Question | None) -> str:
        """Write one line, without its end.

        Args:
            seen: the frame or malformed bytes.
            question: for a reply, the request that it answers, where that was seen.
        """
        number, time, _, flow, item, _ = seen
        ends = self._ends.get(flow) or self._remember_ends(flow)
        if isinstance(item, Malformed):
            return f"{number:>6} {self._time(time)} {ends} {'-':>5} {'-':>5} {self._malformed(item)}"
        found = item.layout
        if found is None:
            text = self._odd(item, question, flow.direction is _REQUEST)
        else:
            key = (found[0], question, flow.direction is _REQUEST)
            phrase = self._phrases.get(key) or self._remember(key, item)
            text = phrase.fill(found[1])
        return "%6d %s %s %5d %5d %s" % (number, self._time(time), ends, item.serial, item.reserved, text)

    def _remember_ends(self, flow: Flow) -> str:
        if len(self._ends) >= MOST_PHRASES:
            self._ends.clear()
        color = self._palette
        arrow = f"{flow.src_text} > {flow.dst_text} {flow.conversation.transport} {flow.direction:<8}"
        self._ends[flow] = text = f"{color.dim}{printable(arrow)}{color.reset}"
        return text

    def _remember(self, key: tuple[Layout, Question | None, bool], frame: Frame) -> Phrase:
        if len(self._phrases) >= MOST_PHRASES:
            self._phrases.clear()
        self._phrases[key] = phrase = self._phrase(frame, key[1], key[2])
        return phrase

    def _phrase(self, frame: Frame, question: Question | None, asks: bool) -> Phrase:
        builder = PhraseBuilder()
        if asks:
            asked = question_of(frame)
            builder.text(self._function(asked))
            builder.arguments(frame.arguments, partial(request_role, asked.function_id))
        else:
            builder.text(self._result(frame.code))
            if question is not None:
                builder.text(f" {self._function(question)}")
            function_id = question.function_id if question else None
            builder.arguments(frame.arguments, partial(result_role, function_id))
        return builder.done()

    def _function(self, question: Question) -> str:
        color = self._palette
        name = f"{color.name}{function_name(question.function_id)}{color.reset}"
        if question.command is None:
            return name
        return f"{name} {color.name}{printable(question.command[:120])}{color.reset}"

    def _result(self, code: int) -> str:
        color = self._palette
        name = hresult_name(code)
        if is_failure(code):
            return f"{color.bad}{name} ({describe(code).text}){color.reset}"
        return f"{color.dim if code == S_EXECUTING else color.good}{name}{color.reset}"

    def _odd(self, frame: Frame, question: Question | None, asks: bool) -> str:
        text = self._phrase(frame, question, asks).fill(flatten(frame.arguments))
        reasons = "; ".join(f"{problem.reason} (at {problem.offset})" for problem in frame.problems)
        framing = "" if frame.framing.value == "plain" else f" [{frame.framing.value}]"
        if not reasons:
            return f"{text}{framing}"
        return f"{text}{framing} {self._palette.problem}!! {reasons}{self._palette.reset}"

    def _malformed(self, item: Malformed) -> str:
        reasons = "; ".join(problem.reason for problem in item.problems)
        shown = item.raw[:LONGEST_RAW].hex(" ")
        more = f" … {len(item.raw) - LONGEST_RAW} more bytes" if len(item.raw) > LONGEST_RAW else ""
        return f"{self._palette.problem}!! {reasons}{self._palette.reset} {shown}{more}".rstrip()
