"""Files that commands write besides stdout."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Self

import click

from bcapscope.errors import FileWriteError

force_option = click.option("--force", is_flag=True, help="Overwrite what is there.")


def check_output_path(path: Path, overwrite: bool | None = None) -> None:
    """Make sure that a file may be written there.

    Args:
        path: of the file.
        overwrite: it may be there already; None where the command has no `--force` that would say so.

    Raises:
        FileWriteError: something is there already, or is no file.
    """
    is_there = os.path.exists(path)  # that of Path has an exception for a name that is too long
    if is_there and not path.is_file():
        raise FileWriteError(path, "no file, but something else is there")
    if is_there and not overwrite:
        hint = "" if overwrite is None else "; --force overwrites it"
        raise FileWriteError(path, f"exists already{hint}")


class AtomicFile:
    """A file that gets its name when it is complete; until then it stands beside, under a name of its own.

    What is not kept is removed, so that a command that fails leaves nothing half written; nor does one that a
    signal ends, after `interrupt_on_end_signals`, as nothing is there before it is written in the block. It
    is open only while something is written, so that there may be any number of them.
    """

    def __init__(self, path: Path) -> None:
        """Begin a file that is to stand where `path` is."""
        self._path = path
        self._temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
        self._mode = "xb"

    def write(self, data: bytes) -> None:
        """Write some more.

        Raises:
            FileWriteError: nothing can be written there, or there is no more room.
        """
        try:
            with self._temporary.open(self._mode) as file:
                self._mode = "ab"
                file.write(data)
        except OSError as error:
            raise FileWriteError(self._path, _error_text(error)) from None

    def commit(self, path: Path | None = None, overwrite: bool = False) -> None:
        """Give the file, to which something was written, its name, or another one in the same directory;
        nothing is written afterwards.

        Raises:
            FileWriteError: something is there already, or it cannot have that name.
        """
        path = self._path if path is None else path
        check_output_path(path, overwrite)
        try:
            self._temporary.replace(path)
        except OSError as error:
            raise FileWriteError(path, _error_text(error)) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.discard()

    def discard(self) -> None:
        """Remove the file unless it was kept."""
        with suppress(OSError):  # it is not there, or cannot be
            self._temporary.unlink()


def _error_text(error: OSError) -> str:
    return (error.strerror or str(error)).lower()
