"""One line a frame, for people."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from bcapscope.protocol.arguments import Problem
from bcapscope.protocol.frame import Frame, Framing, Malformed
from bcapscope.protocol.functions import function_name
from bcapscope.protocol.hresult import S_EXECUTING, describe, hresult_name, is_failure
from bcapscope.protocol.layout import Layout, flatten
from bcapscope.protocol.roles import request_role, result_role
from bcapscope.render.escape import printable
from bcapscope.render.moment import Clock, time_writer
from bcapscope.render.palette import PLAIN, Palette
from bcapscope.render.phrase import LONGEST_STRING, Phrase, PhraseBuilder
from bcapscope.render.tongue import Tongue, english
from bcapscope.traffic.observation import Direction, Flow, Observation
from bcapscope.traffic.question import Question

MOST_PHRASES = 4096
"""Phrases and flow texts kept; when there are more, all are forgotten and made again."""

LONGEST_RAW = 48
"""Bytes of a malformed item that its line shows."""


class LineRenderer:
    """Writes frames as lines, in the order in which they were seen."""

    def __init__(
        self,
        clock: Clock = Clock.RELATIVE,
        palette: Palette = PLAIN,
        brief: bool = False,
        ends: Callable[[Flow], str] | None = None,
        tongue: Tongue = english,
    ) -> None:
        """Choose the looks.

        Args:
            clock: how the time is told.
            palette: colours.
            brief: leave problems and comments to `remarks`.
            ends: writes who spoke to whom, harmless; addresses, transport and kind unless given.
            tongue: of the words.
        """
        self._palette = palette
        self._ends_text = ends or _addresses
        self._brief = brief
        self._tongue = tongue
        self._time = time_writer(clock)
        self._phrases: dict[tuple[Flow, Layout, Question | None], Phrase] = {}

    def begin(self, time: int) -> None:
        """Count relative times from `time`, not from the first line."""
        self._time(time)

    def line(self, seen: Observation, question: Question | None, comments: tuple[str, ...] = ()) -> str:
        """Write one line, without its end.

        Args:
            seen: the frame or malformed bytes.
            question: what a request asks, or a reply answers where that was seen.
            comments: that the capture has on it.
        """
        if comments and not self._brief:
            remarks = "".join(f"  # {printable(comment)}" for comment in comments)
            return f"{self.line(seen, question)}{self._palette.dim}{remarks}{self._palette.reset}"
        number, time, _, flow, item, _ = seen
        if isinstance(item, Malformed):
            return self._malformed(seen, item)
        found = item.layout
        if found is None:
            head = number, self._time(time), item.serial, item.reserved
            return self._odd(flow, item, question).fill(head, flatten(item.arguments))
        layout, numbers = found
        key = flow, layout, question
        phrase = self._phrases.get(key) or self._remember(key, item)
        text, places = phrase.text, phrase.places
        if len(places) == 1:  # nearly all frames that come by the million, so no call for them
            where, write = places[0]
            return text % (number, self._time(time), item.serial, item.reserved, write(numbers[where]))
        return phrase.fill((number, self._time(time), item.serial, item.reserved), numbers)

    def remarks(self, seen: Observation, comments: tuple[str, ...]) -> Iterator[str]:
        """Write what stands at the end of a line that is not brief, a line each."""
        color = self._palette
        for comment in comments:
            yield f"{color.dim}# {printable(comment)}{color.reset}"
        for problem in seen.item.problems:
            yield f"{color.problem}!! {self._reason(problem)}{color.reset} (at {problem.offset})"

    def _reason(self, problem: Problem) -> str:
        return printable(self._tongue(problem.reason))

    def _remember(self, key: tuple[Flow, Layout, Question | None], frame: Frame) -> Phrase:
        if len(self._phrases) >= MOST_PHRASES:
            self._phrases.clear()
        self._phrases[key] = phrase = self._builder(key[0], frame, key[2]).done()
        return phrase

    def _builder(self, flow: Flow, frame: Frame, question: Question | None) -> PhraseBuilder:
        builder = PhraseBuilder(f"%6d %s {self._ends(flow)} %5d %5d ")
        function_id = question.function_id if question else None
        if flow.direction is Direction.RESPONSE:
            builder.text(self._result(frame.code))
        if question is not None:
            builder.text(self._function(question))
        role = request_role if flow.direction is Direction.REQUEST else result_role
        builder.arguments(frame.arguments, partial(role, function_id))
        return builder

    def _ends(self, flow: Flow) -> str:
        color = self._palette
        return f"{color.dim}{self._ends_text(flow)}{color.reset}".replace("%", "%%")

    def _function(self, question: Question) -> str:
        color = self._palette
        name = f" {color.name}{function_name(question.function_id)}{color.reset}"
        if question.command is None:
            return name
        return f"{name} {color.name}{printable(question.command[:LONGEST_STRING])}{color.reset}"

    def _result(self, code: int) -> str:
        color = self._palette
        name = hresult_name(code)
        if is_failure(code):
            return f" {color.bad}{name} ({self._tongue(describe(code).text)}){color.reset}"
        return f" {color.dim if code == S_EXECUTING else color.good}{name}{color.reset}"

    def _odd(self, flow: Flow, frame: Frame, question: Question | None) -> Phrase:
        builder = self._builder(flow, frame, question)
        if frame.framing is not Framing.PLAIN:
            builder.text(f" [{frame.framing.value}]")
        if frame.problems and not self._brief:
            reasons = "; ".join(
                f"{self._reason(problem)} (at {problem.offset})" for problem in frame.problems
            )
            builder.text(f" {self._palette.problem}!! {reasons}{self._palette.reset}")
        return builder.done()

    def _malformed(self, seen: Observation, item: Malformed) -> str:
        reasons = "; ".join(map(self._reason, item.problems))
        shown = item.raw[:LONGEST_RAW].hex(" ")
        left = len(item.raw) - LONGEST_RAW
        more = f" … {self._tongue(f'{left} more bytes')}" if left > 0 else ""
        ends = self._ends(seen.flow).replace("%%", "%")
        head = f"{seen.number:>6} {self._time(seen.time)} {ends} {'-':>5} {'-':>5}"
        if self._brief:
            return f"{head}  {shown}{more}"
        problem = f"{self._palette.problem}!! {reasons}{self._palette.reset}"
        return f"{head}  {shown}{more}{' ' if shown else ''}{problem}"


def _addresses(flow: Flow) -> str:
    return printable(f"{flow.src_text} > {flow.dst_text} {flow.conversation.transport} {flow.direction:<8}")
