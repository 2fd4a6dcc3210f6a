"""Where fuzzing begins: the tests' own samples, sound, glued and damaged."""

from __future__ import annotations

from tests.frames import ARGUMENTS, FRAMES


def _framed(argument: bytes) -> bytes:
    return b"\x01" + (16 + len(argument)).to_bytes(4, "little") + bytes(8) + b"\x01\x00" + argument + b"\x04"


def frame_seeds() -> list[bytes]:
    """Datagrams."""
    return [pair.data for pair in FRAMES] + [_framed(pair.data) for pair in ARGUMENTS]


def stream_seeds() -> list[bytes]:
    """Streams behind their cuts, as `tests.fuzz.targets.stream` takes them."""
    frames = [pair.data for pair in FRAMES]
    heads = (b"\x01\x00", b"\x00\x02\x07\x20", b"\x03\x03\x10\x00\x05")
    bodies = (
        b"".join(frames),
        b"\x01\x01" + frames[2] + b"\x01garbage" + frames[3],
        frames[4][:-3] + frames[0],
    )
    return [head + body for head in heads for body in (*bodies, *frames)]


SEEDS = {"frame": frame_seeds, "stream": stream_seeds}
