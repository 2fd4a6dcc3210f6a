"""What belongs to a frame, in words, as numbers and as a filter: for the screen that goes there."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from bcapscope.capture.journal import Journal
from bcapscope.protocol.functions import FUNCTIONS, function_name
from bcapscope.protocol.numerals import read_integer, read_number
from bcapscope.render.call import milliseconds
from bcapscope.render.escape import printable, quoted
from bcapscope.traffic.exchange import Exchange, Settled
from bcapscope.traffic.getters import Told
from bcapscope.tui.words import say
from bcapscope.tui.words import told as spoken

_MOMENT = re.compile(r"([0-9]+(?:\.[0-9]*)?)\s*s")
_LATEST = 1e9  # seconds after the start, 30 years
_MOST_IN_CHAIN = 64


def frames_of(settled: Settled | None) -> frozenset[int]:
    """Number the frames of a call."""
    if not isinstance(settled, Exchange):
        return frozenset()
    return frozenset(event.seen.number for event in settled.events)


def about(told: Told, settled: Settled | None, note: str | None) -> str:
    """Say in one line what a frame is."""
    number = told.seen.number
    parts = []
    if isinstance(settled, Exchange):
        role = next((event.role for event in settled.events if event.seen.number == number), "")
        parts.append(say("traffic.about.request", number=number, role=spoken(role), call=settled.call))
        reply, time = settled.reply, settled.latency
        if reply is None or time is None:
            parts.append(say(f"traffic.about.{settled.outcome}"))
        elif reply.number != number:
            parts.append(say("traffic.about.answered", frame=reply.number, time=milliseconds(time)))
    elif settled is not None:
        parts.append(say("traffic.about.stray", number=number))
    else:
        parts.append(say("traffic.about.frame", number=number))
    if told.seen.packet and told.seen.packet != number:
        parts.append(say("traffic.about.packet", packet=told.seen.packet))
    flow = told.seen.flow
    parts.append(printable(f"{flow.src_text} > {flow.dst_text} {flow.conversation.transport}"))
    parts += [f"# {printable(spoken(comment))}" for comment in told.comments]
    parts += [f"# {printable(note)}"] if note else []
    return " " + " · ".join(parts)


def partner(settled: Settled | None, number: int) -> tuple[int | None, str]:
    """Find the reply to a request, or the request of a reply; or the key of why there is none."""
    if not isinstance(settled, Exchange):
        return None, "traffic.no_call" if settled is None else "traffic.no_request"
    asked = [seen.number for seen in settled.requests]
    if number in asked:
        return (None, "traffic.no_partner") if settled.reply is None else (settled.reply.number, "")
    before = [each for each in asked if each < number]
    return (before or asked)[-1], ""


def expression(what: str, told: Told, settled: Settled | None) -> str | None:
    """Write the filter for all that has to do with a frame; None where there is nothing.

    Args:
        what: client, handle, chain or kind.
        told: the frame.
        settled: its call.
    """
    client = f"client == {told.seen.flow.conversation.client}"
    if what == "client":
        return client
    if what == "chain":
        frames = sorted(frames_of(settled))[:_MOST_IN_CHAIN]
        return f"frame in ({', '.join(map(str, frames))})" if frames else None
    if what == "kind":
        return _kind(told)
    handle = _handle(settled)
    return None if handle is None else f"{client} and arg[0] == {handle}"


def _kind(told: Told) -> str | None:
    question = told.question
    if question is None:
        return None
    text = f"function_id == {question.function_id}"
    if question.function_id in FUNCTIONS:
        text = f"function == {function_name(question.function_id)}"
    return text if question.command is None else f"{text} and command == {quoted(question.command)}"


def _handle(settled: Settled | None) -> int | None:
    if not isinstance(settled, Exchange):
        return None
    function = FUNCTIONS.get(settled.question.function_id)
    arguments = settled.request.item.arguments
    if (
        function is None
        or not arguments
        or not function.params
        or not function.params[0].name.startswith("h")
    ):
        return None
    value = arguments[0].variant.value
    return value if type(value) is int else None


def frame_at(text: str, journal: Journal) -> int | None:
    """Find the frame with a number, or the first from so many seconds after the start on, as in ``12.5s``.

    Returns:
        Its number, the last one's where the journal ends before; None where the text is neither.
    """
    text = text.strip()
    number = read_integer(text, 0, 1 << 63)
    if number is not None:
        return max(1, min(number, len(journal)))
    moment = _MOMENT.fullmatch(text)
    seconds = read_number(moment[1], 0, _LATEST) if moment else None
    if seconds is None:
        return None
    aim = journal.time(1) + round(seconds * 1e9)
    low, high = 1, len(journal)
    while low < high:
        middle = (low + high) // 2
        if journal.time(middle) < aim:
            low = middle + 1
        else:
            high = middle
    return low


def notes_by_packet(marks: Mapping[int, str], told: Callable[[int], Told]) -> dict[int, str]:
    """Put notes on frames on the packets that completed these; several on one packet are joined."""
    notes: dict[int, str] = {}
    for number, note in sorted(marks.items()):
        seen = told(number).seen
        if not seen.packet:
            continue
        before = notes.get(seen.packet, "")
        notes[seen.packet] = f"{before}; {note}" if before and note else before or note
    return notes
