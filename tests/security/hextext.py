"""Pasted text without end, or of many megabytes: `decode --text` reads it in bounded memory.

Each text is generated while it is read from a pipe.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from itertools import repeat
from pathlib import Path

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from tests.security.harness import MEMORY_LIMIT, Ended, run_measured

MEGABYTE = 1 << 20
_UNREADABLE = 4
_FRAME = encode_frame(
    1, 0, 64, (Variant(VT.I4, 1), Variant(VT.BSTR, "slvMove"), Variant.array(VT.R8, (0.5,) * 8))
)


def _lines(line: str, size: int) -> Iterator[bytes]:
    data = f"{line}\n".encode()
    yield from repeat(data * 100, size // len(data) // 100)


def _dump(size: int) -> Iterator[bytes]:
    for place in range(0, size // 4, 16):
        row = (_FRAME * 2)[place % len(_FRAME) :][:16]
        yield f"{place:08x}  {row.hex(' ')}\n".encode()


def texts(size: int) -> dict[str, tuple[Iterator[bytes], bool]]:
    """Return texts of about `size` bytes by name, and whether they can be read to their end."""
    zeros = repeat(bytes(65536), size // 65536)
    return {
        "rows of digits": (_lines("01 " * 16, size), True),
        "one digit a line": (_lines("0", size // 4), True),
        "frames, a line each": (_lines(_FRAME.hex(" "), size), True),
        "a dump of frames": (_dump(size), True),
        "prose": (_lines("Add a face to the facade, 01 02 03.", size // 4), True),
        "captions": (_lines("TX(Client->Server)\n01 10 00 00 00 00", size // 4), True),
        "digits without a line end": (repeat(b"01" * 4096, size // 8192), False),
        "spaces without a line end": (repeat(b" " * 8192, size // 8192), False),
        "zeros": (zeros, False),
    }


def attack(folder: Path, size: int) -> Iterator[tuple[str, Ended]]:
    """Let `decode --text` read each text, and devices without end; yield how each ended."""
    for name, (pieces, is_readable) in texts(size).items():
        path = folder / "text"
        with path.open("wb") as file:
            file.writelines(pieces)
        sources: tuple[tuple[str | Path, Path | None], ...] = (path, None), ("-", path)
        for source, stdin in sources:
            ended = run_measured(["decode", "--text", source], stdin, patience=600)
            assert is_readable == (not ended.err.count("has more than")), ended.err
            assert ended.code in ((0, 4) if is_readable else (3, 4)), (ended.code, ended.err)
            yield f"{name}{' from a pipe' if stdin else ''}", ended
    ended = run_measured(["decode", "--text", "/dev/zero"])
    assert ended.code == _UNREADABLE, ended.err
    yield "/dev/zero", ended


def main() -> None:
    """Read texts of 60 MB; exit with 1 if one used too much."""
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        for what, ended in attack(Path(name), 60 * MEGABYTE):
            failed += ended.peak >= MEMORY_LIMIT
            print(f"{what}: {ended.peak:.0f} MB, {ended.seconds:.1f} s, exit {ended.code}", flush=True)
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
