"""`bcapscope decode` beside its peers, all in one run: seconds, processor seconds, peak memory, ratios.

Peers are tshark with `bcap.lua`, tshark without any b-CAP, and the bare loops of `loops.py`. The dissector of
`bcapscope wireshark` is timed, too; it must not be slower than `bcap.lua`.
Run from the project's root as ``python -m tests.bench.decode``.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from bcapscope.wireshark.dissector import dissector_text
from tests.bench.jobs import HERE, Figures, Job, main, memory, python, ratios, tshark

JSON_FRAMES = 100_000

_FOLDER = tempfile.TemporaryDirectory()
_DISSECTOR = Path(_FOLDER.name) / "bcapscope.lua"
_DISSECTOR.write_text(dissector_text(), encoding="utf-8")

OWN_LUA = ("-X", f"lua_script:{_DISSECTOR}")
LUA = ("-X", f"lua_script:{HERE / 'bcap.lua'}")
OWN = "tshark, dissector of bcapscope"
PEER, ALONE, PEER_JSON = "tshark, b-CAP in Lua", "tshark, no b-CAP", "tshark -T json, b-CAP in Lua"
LINES, JSON = "bcapscope decode", "bcapscope decode --json"
HEADERS, ARGUMENTS = "bare loop over headers", "bare loop over all arguments"


def jobs(frames: int, long_frames: int) -> list[Job]:
    """List what to run: text on `frames`, JSON on that and 100,000, ours on `long_frames` too."""
    json = min(frames, JSON_FRAMES)
    decode = python("bcapscope", "decode", "{}")
    return [
        Job(HEADERS, frames, python("tests.bench.loops", "headers", "{}")),
        Job(ARGUMENTS, frames, python("tests.bench.loops", "arguments", "{}")),
        Job(PEER, frames, tshark(*LUA), b" b-CAP "),
        Job(OWN, frames, tshark(*OWN_LUA), b" b-CAP "),
        Job(ALONE, frames, tshark(), b"\n"),
        Job(PEER_JSON, json, tshark(*LUA, "-T", "json"), b'"bcap.length"'),
        Job(LINES, frames, decode, b"\n"),
        Job(JSON, json, (*decode, "--json"), b"\n"),
        Job(JSON, frames, (*decode, "--json"), b"\n"),
        Job(LINES, long_frames, decode, b"\n"),
    ]


def told(figures: Figures, frames: int, long_frames: int) -> Iterator[str]:
    """Yield how often each peer's time is ours, and what memory does when the capture grows."""
    pairs = [
        (PEER, OWN, frames),
        (PEER, LINES, frames),
        (ALONE, LINES, frames),
        (PEER_JSON, JSON, min(frames, JSON_FRAMES)),
    ]
    pairs += [(ARGUMENTS, LINES, frames), (HEADERS, LINES, frames)]
    yield from ratios(figures, pairs)
    yield from memory(figures, LINES, frames, long_frames)


if __name__ == "__main__":
    main(__doc__, jobs, told)
