"""Files that are opened before anything moves, so that it is known then whether they can be written."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


@contextmanager
def open_new_file(path: str | None) -> Iterator[BinaryIO | None]:
    """Open a file for the length of a block; one to which nothing was written is not there afterwards.

    Args:
        path: of the file; None for none.

    Raises:
        OSError: it cannot be written, or is there already.
    """
    if path is None:
        yield None
        return
    file = open(path, "xb")  # noqa: SIM115 - closing it may fail, which must not end the block
    try:
        yield file
    finally:
        is_empty = not file.tell()
        with suppress(OSError):  # who wrote has flushed, and knows
            file.close()
        if is_empty:
            Path(path).unlink(missing_ok=True)
