"""Text about captures: what was read, which end is the controller, and how two clocks differ."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.messages.places import Count
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.traffic.observation import Conversation, ServerEvidenceKind

if TYPE_CHECKING:
    from bcapscope.traffic.joining.clock_estimate import ClockEstimate


def capture_counts_text(counts: CaptureCounts, words: MessageFormatter = ENGLISH_WORDS) -> str:
    """Count the frames that were found, and the packets and bytes that were missing, damaged or not b-CAP."""
    return words("list.semicolon").join(map(words.text, _count_messages(counts)))


def _count_messages(counts: CaptureCounts) -> Iterator[Message]:
    yield Message(
        "counts.frames", frames=Count(counts.frames, "frame"), packets=Count(counts.packets, "packet")
    )
    if counts.malformed:
        yield Message("counts.malformed", n=counts.malformed)
    if counts.gaps:
        yield Message("counts.gaps", gaps=Count(counts.gaps, "gap"), missing=Count(counts.missing, "byte"))
    for name, place, count, unit in (
        ("foreign", "packets", counts.not_bcap + counts.not_ip, "packet"),
        ("cut", "packets", counts.cut, "packet"),
        ("broken", "packets", counts.broken, "packet"),
        ("fragments", "datagrams", counts.fragments_lost, "datagram"),
        ("contradictions", "segments", counts.contradictions, "tcp-segment"),
    ):
        if count:
            yield Message(f"counts.{name}", **{place: Count(count, unit)})
    for link, count in sorted(counts.unknown_links.items()):
        yield Message("counts.unknown-link", packets=Count(count, "packet"), link=link)


def server_evidence_message(conversation: Conversation) -> Message:
    """Say how bcapscope knows which end of a conversation is the controller."""
    kind, code = conversation.server_evidence
    if kind is ServerEvidenceKind.RESULT:
        return Message("server-by.result", server=str(conversation.server), code=f"0x{code:08X}")
    if kind is ServerEvidenceKind.CALL:
        return Message("server-by.call", client=str(conversation.client), function=function_name(code))
    if kind is ServerEvidenceKind.PORT:
        return Message("server-by.port", port=conversation.server.port)
    return Message(f"server-by.{kind}")


def places_message(near: str, far: str, clock: ClockEstimate) -> Message:
    """Say which capture was taken at which side, and how the two clocks differ. `near` and `far` are the
    escaped names of the captures from the client's and from the controller's side."""
    offset, error = f"{clock.points[0][1] / 1e6:+.3f}", f"{clock.error / 1e6:.3f}"
    if clock.drift is None:
        return Message("reading.places", near=near, far=far, offset=offset, error=error)
    drift = f"{clock.drift * 1e6:+.1f}"
    return Message("reading.places.drift", near=near, far=far, offset=offset, error=error, drift=drift)
