"""Describe a frame, find the frame's request or reply, and make filters for related frames."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Callable, Mapping

from bcapscope.capture.observation_store import ObservationStore
from bcapscope.protocol.number_parsing import parse_integer, parse_number
from bcapscope.protocol.tables.function_table import FUNCTIONS, function_name
from bcapscope.render.call_text import milliseconds
from bcapscope.render.escape import printable, quoted
from bcapscope.traffic.call import Call, PairingResult
from bcapscope.traffic.filter.getters import AnnotatedFrame
from bcapscope.traffic.joining.joined_observation import sighting_numbers
from bcapscope.tui.reader_language import label

_SECONDS_PATTERN = re.compile(r"([0-9]+(?:\.[0-9]*)?)\s*s")
_MAX_SECONDS = 1e9  # 30 years after the start
_MAX_FRAMES_IN_FILTER = 64


def call_frames(settled: PairingResult | None) -> frozenset[int]:
    """Return the numbers of the frames of a call, at all places where they were captured."""
    if not isinstance(settled, Call):
        return frozenset()
    return frozenset(number for event in settled.frames for number in sighting_numbers(event.observation))


def frame_description(frame: AnnotatedFrame, settled: PairingResult | None, note: str | None) -> str:
    number = frame.observation.number
    parts = []
    if isinstance(settled, Call):
        role = next(event.role for event in settled.frames if number in sighting_numbers(event.observation))
        name = label(f"traffic.role.{role.name.lower()}")
        parts.append(label("traffic.about.request", number=number, role=name, call=settled.number))
        reply, time = settled.reply, settled.latency
        if reply is None or time is None:
            parts.append(label(f"traffic.about.{settled.outcome}"))
        elif number not in sighting_numbers(reply):
            parts.append(label("traffic.about.answered", frame=reply.number, time=milliseconds(time)))
    elif settled is not None:
        parts.append(label("traffic.about.stray", number=number))
    else:
        parts.append(label("traffic.about.frame", number=number))
    if frame.observation.packet and frame.observation.packet != number:
        parts.append(label("traffic.about.packet", packet=frame.observation.packet))
    flow = frame.observation.flow
    parts.append(printable(f"{flow.src_text} > {flow.dst_text} {flow.conversation.transport}"))
    parts += [f"# {printable(comment)}" for comment in frame.comments]
    parts += [f"# {printable(note)}"] if note else []
    return " " + " · ".join(parts)


def find_partner(settled: PairingResult | None, number: int) -> tuple[int | None, str]:
    """Return the number of the frame's partner (request or reply), or None and the label id of the reason."""
    if not isinstance(settled, Call):
        return None, "traffic.no_call" if settled is None else "traffic.no_request"
    attempts = [seen.number for seen in settled.attempts]
    if any(number in sighting_numbers(seen) for seen in settled.attempts):
        return (None, "traffic.no_partner") if settled.reply is None else (settled.reply.number, "")
    before = [each for each in attempts if each < number]
    return (before or attempts)[-1], ""


def related_filter(relation: str, frame: AnnotatedFrame, settled: PairingResult | None) -> str | None:
    """Return a filter expression that selects the frames related to a frame; None if no frames are related.
    `relation` is ``client``, ``handle``, ``chain`` (same call) or ``kind`` (same function).
    """
    client = f"client == {frame.observation.flow.conversation.client}"
    if relation == "client":
        return client
    if relation == "chain":
        frames = sorted(call_frames(settled))[:_MAX_FRAMES_IN_FILTER]
        return f"frame in ({', '.join(map(str, frames))})" if frames else None
    if relation == "kind":
        return _kind_filter(frame)
    handle = _handle_of(settled)
    return None if handle is None else f"{client} and arg[0] == {handle}"


def _kind_filter(frame: AnnotatedFrame) -> str | None:
    kind = frame.call_kind
    if kind is None:
        return None
    text = f"function_id == {kind.function_id}"
    if kind.function_id in FUNCTIONS:
        text = f"function == {function_name(kind.function_id)}"
    return text if kind.command is None else f"{text} and command == {quoted(kind.command)}"


def _handle_of(settled: PairingResult | None) -> int | None:
    if not isinstance(settled, Call):
        return None
    function = FUNCTIONS.get(settled.kind.function_id)
    arguments = settled.request.item.arguments
    if function is None or not function.takes_handle or not arguments:
        return None
    value = arguments[0].variant.value
    return value if type(value) is int else None


def find_frame(text: str, journal: ObservationStore) -> int | None:
    """Find a frame by its number, or by a time in seconds after the start, such as ``12.5s``. A time selects
    the first frame at or after this time. A number or time that is too large selects the last frame.
    """
    text = text.strip()
    number = parse_integer(text, 0, 1 << 63)
    if number is not None:
        return max(1, min(number, len(journal)))
    moment = _SECONDS_PATTERN.fullmatch(text)
    seconds = parse_number(moment[1], 0, _MAX_SECONDS) if moment else None
    if seconds is None:
        return None
    aim = journal.time_of(1) + round(seconds * 1e9)
    numbers = range(1, len(journal))
    return bisect_left(numbers, aim, key=journal.time_of) + 1


def notes_by_packet(marks: Mapping[int, str], read_frame: Callable[[int], AnnotatedFrame]) -> dict[int, str]:
    """Return notes by packet number. A frame's note belongs to the packet that completed the frame."""
    notes: dict[int, str] = {}
    for number, note in sorted(marks.items()):
        packet = read_frame(number).observation.packet
        if packet:
            notes[packet] = "; ".join(filter(None, (notes.get(packet), note)))
    return notes
