"""New files, opened before anything moves, so that an unwritable path is found in time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


@contextmanager
def open_new_file(path: str | None) -> Iterator[BinaryIO | None]:
    """Open a new file for the length of a block; delete it afterwards if nothing was written to it.

    Without a path, there is no file. A file that exists or cannot be written raises OSError.
    """
    if path is None:
        yield None
        return
    file = open(path, "xb")  # noqa: SIM115 - closing it may fail, which must not end the block
    try:
        yield file
    finally:
        is_empty = not file.tell()
        with suppress(OSError):  # the writer has flushed, and knows of any error
            file.close()
        if is_empty:
            Path(path).unlink(missing_ok=True)
