"""What became of the packets of a capture, in one line."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.protocol.text_format import counted


def capture_counts_text(counts: CaptureCounts) -> str:
    """Say how many frames were found, and what else was met."""
    return f"{counted(counts.frames, 'frame')} in {counted(counts.packets, 'packet')}" + "".join(
        f"; {text}" for text in _problem_texts(counts)
    )


def _problem_texts(counts: CaptureCounts) -> Iterator[str]:
    if counts.malformed:
        yield f"{counts.malformed} malformed"
    if counts.gaps:
        yield f"{counted(counts.gaps, 'gap')} of {counted(counts.missing, 'byte')} in all"
    if counts.not_bcap + counts.not_ip:
        yield f"{counted(counts.not_bcap + counts.not_ip, 'packet')} of other protocols"
    if counts.cut:
        yield f"{counted(counts.cut, 'packet')} cut short by the capture"
    if counts.broken:
        yield f"{counted(counts.broken, 'packet')} with damaged headers"
    if counts.fragments_lost:
        yield f"{counted(counts.fragments_lost, 'datagram')} with missing fragments"
    if counts.contradictions:
        yield f"{counted(counts.contradictions, 'TCP segment')} sent again with other bytes"
    for link, count in sorted(counts.unknown_links.items()):
        yield f"{counted(count, 'packet')} of link type {link}, which is not known here"
