"""Output files: check the path before writing, and remove incomplete files after a failure."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Self

import click

from bcapscope.errors import FileWriteError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason

force_option = click.option("--force", is_flag=True, help="Overwrite existing files.")


def check_output_path(path: Path, overwrite: bool | None = None) -> None:
    """Raise FileWriteError if `path` may not be written. `overwrite` is None for a command that
    has no option `--force`.
    """
    is_there = os.path.exists(path)  # `Path.exists` would raise an exception for a name that is too long
    if is_there and not path.is_file():
        raise FileWriteError(path, Message("file.not-regular"))
    if is_there and not overwrite:
        case = "file.exists" if overwrite is None else "file.exists.force"
        raise FileWriteError(path, Message(case))


class AtomicFile:
    """A file that has a temporary name until `commit` renames it. Its folder does not change.

    If the `with` block ends without `commit`, the file is removed. SIGTERM and SIGHUP end the `with` block
    only if the command called `interrupt_on_end_signals`; otherwise, the file stays. The file is open only
    during a write, so the limit of open files does not matter.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
        self._mode = "xb"

    def write(self, data: bytes) -> None:
        try:
            with self._temporary.open(self._mode) as file:
                self._mode = "ab"
                file.write(data)
        except OSError as error:
            raise FileWriteError(self._path, os_reason(error)) from None

    def commit(self, path: Path | None = None, overwrite: bool = False) -> None:
        """Rename the file to its final name, or to `path` in the same folder. Raises FileWriteError."""
        path = self._path if path is None else path
        check_output_path(path, overwrite)
        try:
            self._temporary.replace(path)
        except OSError as error:
            raise FileWriteError(path, os_reason(error)) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):  # the temporary file exists only between the first `write` and `commit`
            self._temporary.unlink()
