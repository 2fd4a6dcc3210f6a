"""Frames as text, one line per frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.protocol.codec.arguments import Problem
from bcapscope.protocol.codec.frame import Frame, Framing, Malformed
from bcapscope.protocol.codec.frame_template import FrameTemplate, numbers_of_arguments
from bcapscope.protocol.tables.function_table import function_name, request_param, result_param
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.escape import printable
from bcapscope.render.line_template import LONGEST_STRING, LineTemplate, LineTemplateBuilder
from bcapscope.render.result_advice import result_text
from bcapscope.render.timestamp import TimeFormat, timestamp_writer
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Direction, Flow, Observation

MAX_TEMPLATES = 4096
"""Maximum number of cached line templates. When the cache is full, the renderer empties it."""

MAX_RAW_BYTES = 48
"""Maximum number of malformed bytes that a line shows."""


class FrameLineRenderer:
    """Writes frames as lines. The renderer counts relative times from the first line that it writes."""

    def __init__(
        self,
        time_format: TimeFormat = TimeFormat.RELATIVE,
        palette: Palette = PLAIN,
        brief: bool = False,
        write_endpoints: Callable[[Flow], str] | None = None,
        words: MessageFormatter = ENGLISH_WORDS,
    ) -> None:
        """Choose the format of the lines. With `brief`, lines omit problems and comments; `remarks` yields
        these instead. `write_endpoints` takes a flow, and returns its endpoints as escaped text. By default,
        the text shows addresses, transport and direction.
        """
        self._palette = palette
        self._write_endpoints = write_endpoints or _addresses
        self._is_brief = brief
        self._words = words
        self._write_time = timestamp_writer(time_format)
        self._templates: dict[tuple[Flow, FrameTemplate, CallKind | None], LineTemplate] = {}

    def set_time_origin(self, time: int) -> None:
        """Count relative times from `time`, in ns since 1970, instead of from the first line."""
        self._write_time(time)

    def line(
        self, observation: Observation, call_kind: CallKind | None, comments: tuple[str, ...] = ()
    ) -> str:
        if comments and not self._is_brief:
            remarks = "".join(f"  # {printable(comment)}" for comment in comments)
            return f"{self.line(observation, call_kind)}{self._palette.dim}{remarks}{self._palette.reset}"
        number, time, _, flow, item, _ = observation
        if isinstance(item, Malformed):
            return self._malformed_line(observation, item)
        found = item.template_match
        if found is None:
            head = number, self._write_time(time), item.serial, item.reserved
            return self._odd_template(flow, item, call_kind).fill(head, numbers_of_arguments(item.arguments))
        frame_template, numbers = found
        key = flow, frame_template, call_kind
        template = self._templates.get(key) or self._make_template(key, item)
        text, places = template.text, template.places
        if len(places) == 1:  # fast path for nearly all frames of a large capture: saves a function call
            where, write = places[0]
            return text % (number, self._write_time(time), item.serial, item.reserved, write(numbers[where]))
        return template.fill((number, self._write_time(time), item.serial, item.reserved), numbers)

    def remarks(self, observation: Observation, comments: tuple[str, ...]) -> Iterator[str]:
        """Yield the comments and problems that a brief line omits, one line each."""
        color = self._palette
        for comment in comments:
            yield f"{color.dim}# {printable(comment)}{color.reset}"
        for problem in observation.item.problems:
            yield f"{color.problem}!! {self._reason(problem)}{color.reset} (at {problem.offset})"

    def _reason(self, problem: Problem) -> str:
        return printable(self._words.text(problem.reason))

    def _make_template(self, key: tuple[Flow, FrameTemplate, CallKind | None], frame: Frame) -> LineTemplate:
        if len(self._templates) >= MAX_TEMPLATES:
            self._templates.clear()
        self._templates[key] = template = self._template_builder(key[0], frame, key[2]).build()
        return template

    def _template_builder(self, flow: Flow, frame: Frame, call_kind: CallKind | None) -> LineTemplateBuilder:
        builder = LineTemplateBuilder(f"%6d %s {self._endpoints_text(flow)} %5d %5d ")
        function_id = call_kind.function_id if call_kind else None
        if flow.direction is Direction.RESPONSE:
            builder.add_text(f" {result_text(frame.code, self._palette, self._words)}")
        if call_kind is not None:
            builder.add_text(self._function(call_kind))
        role = request_param if flow.direction is Direction.REQUEST else result_param
        builder.add_arguments(frame.arguments, partial(role, function_id))
        return builder

    def _endpoints_text(self, flow: Flow) -> str:
        color = self._palette
        return f"{color.dim}{self._write_endpoints(flow)}{color.reset}".replace("%", "%%")

    def _function(self, call_kind: CallKind) -> str:
        color = self._palette
        name = f" {color.name}{function_name(call_kind.function_id)}{color.reset}"
        if call_kind.command is None:
            return name
        return f"{name} {color.name}{printable(call_kind.command[:LONGEST_STRING])}{color.reset}"

    def _odd_template(self, flow: Flow, frame: Frame, call_kind: CallKind | None) -> LineTemplate:
        builder = self._template_builder(flow, frame, call_kind)
        if frame.framing is not Framing.PLAIN:
            builder.add_text(f" [{frame.framing.value}]")
        if frame.problems and not self._is_brief:
            reasons = "; ".join(
                f"{self._reason(problem)} (at {problem.offset})" for problem in frame.problems
            )
            builder.add_text(f" {self._palette.problem}!! {reasons}{self._palette.reset}")
        return builder.build()

    def _malformed_line(self, observation: Observation, item: Malformed) -> str:
        reasons = "; ".join(map(self._reason, item.problems))
        shown = item.raw[:MAX_RAW_BYTES].hex(" ")
        left = len(item.raw) - MAX_RAW_BYTES
        more = f" … {self._words.plural('count.more-byte', left)}" if left > 0 else ""
        ends = self._endpoints_text(observation.flow).replace("%%", "%")
        head = f"{observation.number:>6} {self._write_time(observation.time)} {ends} {'-':>5} {'-':>5}"
        if self._is_brief:
            return f"{head}  {shown}{more}"
        problem = f"{self._palette.problem}!! {reasons}{self._palette.reset}"
        return f"{head}  {shown}{more}{' ' if shown else ''}{problem}"


def _addresses(flow: Flow) -> str:
    return printable(f"{flow.src_text} > {flow.dst_text} {flow.conversation.transport} {flow.direction:<8}")
