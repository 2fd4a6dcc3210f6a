"""Write Wireshark display filters that select packets by their numbers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import groupby

from bcapscope.capture.capture_sequence import STDIN
from bcapscope.capture.packet import PacketOrigin
from bcapscope.messages import MessageFormatter
from bcapscope.render.escape import printable
from bcapscope.traffic.call import Call, StrayReply
from bcapscope.traffic.joining.joined_observation import JoinedObservation


def display_filter(packets: Iterable[int]) -> str:
    """Return the display filter that shows the packets with these numbers in their capture.

    >>> display_filter([4, 5, 6, 9])
    'frame.number in {4..6, 9}'
    """
    numbers = sorted(set(packets))
    runs = [
        [number for _, number in run]
        for _, run in groupby(enumerate(numbers), lambda each: each[1] - each[0])
    ]
    parts = [str(run[0]) if len(run) == 1 else f"{run[0]}..{run[-1]}" for run in runs]
    return f"frame.number in {{{', '.join(parts)}}}"


def packets_of(item: Call | StrayReply) -> list[int]:
    """Return the packet numbers of a call's frames. A frame captured at two places has two packet numbers."""
    frames = (
        [item.observation] if isinstance(item, StrayReply) else [each.observation for each in item.frames]
    )
    return [
        sighting.packet
        for frame in frames
        for sighting in (frame.sightings() if isinstance(frame, JoinedObservation) else (frame,))
    ]


def display_filter_lines(
    found: Iterable[PacketOrigin | None], names_files: bool, words: MessageFormatter
) -> Iterator[str]:
    """Yield the display filter for the packets of each capture. `names_files` adds the capture's name."""
    by_name: dict[str, list[int]] = {}
    for origin in found:
        if origin is not None:
            by_name.setdefault(origin.name, []).append(origin.packet)
    for name, packets in by_name.items():
        shown = display_filter(packets)
        if names_files:
            file = words("reading.stdin") if name == STDIN else printable(name)
            yield words("display-filter.file", file=file, filter=shown)
        else:
            yield words("display-filter", filter=shown)
