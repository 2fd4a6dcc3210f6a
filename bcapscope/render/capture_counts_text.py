"""Describe a capture in one line: the number of decoded frames, and the number of packets without usable
frames.
"""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.messages.places import Count


def capture_counts_text(counts: CaptureCounts, words: MessageFormatter = ENGLISH_WORDS) -> str:
    """Return text with the number of frames found, and the numbers of packets and bytes that were missing,
    damaged or not b-CAP.
    """
    return words("list.semicolon").join(map(words.text, _messages(counts)))


def _messages(counts: CaptureCounts) -> Iterator[Message]:
    yield Message(
        "counts.frames", frames=Count(counts.frames, "frame"), packets=Count(counts.packets, "packet")
    )
    if counts.malformed:
        yield Message("counts.malformed", n=counts.malformed)
    if counts.gaps:
        yield Message("counts.gaps", gaps=Count(counts.gaps, "gap"), missing=Count(counts.missing, "byte"))
    foreign = counts.not_bcap + counts.not_ip
    if foreign:
        yield Message("counts.foreign", packets=Count(foreign, "packet"))
    if counts.cut:
        yield Message("counts.cut", packets=Count(counts.cut, "packet"))
    if counts.broken:
        yield Message("counts.broken", packets=Count(counts.broken, "packet"))
    if counts.fragments_lost:
        yield Message("counts.fragments", datagrams=Count(counts.fragments_lost, "datagram"))
    if counts.contradictions:
        yield Message("counts.contradictions", segments=Count(counts.contradictions, "tcp-segment"))
    for link, count in sorted(counts.unknown_links.items()):
        yield Message("counts.unknown-link", packets=Count(count, "packet"), link=link)
