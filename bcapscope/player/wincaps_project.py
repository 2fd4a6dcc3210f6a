"""Projects of WINCAPS III: search for control logs that can be read.

No public source describes how a project stores a log itself, so bcapscope does not guess. It looks for
exported logs in the project. If there are none, the error lists what the project holds and says what to
export.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from bcapscope.errors import BcapError
from bcapscope.player.trajectory import Trajectory, TrajectoryError
from bcapscope.protocol.text_format import counted

FileReader: TypeAlias = Callable[[Path], tuple[Trajectory, ...]]

MAX_FILES = 5000
"""Files of a folder that are examined."""

MAX_TRAJECTORIES = 64
"""Trajectories that are read from a folder; nobody chooses from more."""

_DEEPEST = 8
_SUFFIXES = frozenset((".csv", ".tsv", ".txt", ".log", ".json", ".yaml", ".yml"))
_MAX_KINDS, _MAX_REASONS = 8, 3


def is_project(path: Path) -> bool:
    """Return whether a path is a folder or a project file."""
    try:
        return path.is_dir() or (path.suffix.casefold() == ".wpj" and path.is_file())
    except ValueError:  # not a valid path; the file reader reports that
        return False


def read_project(path: Path, read_file: FileReader) -> tuple[Trajectory, ...]:
    """Read every control log in a project.

    Args:
        path: Path of the project's folder or file.
        read_file: Reads one file.

    Returns: The trajectories by file. Reading stops after the file that reaches `MAX_TRAJECTORIES`. A table
        without titles does not count as a log, because it may hold anything. Neither does a capture, which no
        program exports here.

    Raises:
        TrajectoryError: There is no control log; the message lists what there is and what to export.
        OSError: The folder cannot be read.
    """
    folder = path if path.is_dir() else path.parent
    found: list[Trajectory] = []
    seen: list[Path] = []
    refused: list[str] = []
    for file in _files(folder):
        seen.append(file)
        if len(found) < MAX_TRAJECTORIES and file.suffix.casefold() in _SUFFIXES:
            try:
                found += _with_file_name(read_file(file), str(file.relative_to(folder)))
            except (BcapError, OSError) as error:
                refused.append(f"{file.relative_to(folder)}: {error}")
    if not found:
        raise TrajectoryError(_nothing_found(path, seen, refused))
    return tuple(found)


def _files(folder: Path) -> Iterator[Path]:
    """Yield the files in a folder and its subfolders, in order, without following links."""
    os.scandir(folder).close()  # raises if the folder cannot be read, which os.walk does not
    count = 0
    for place, folders, names in os.walk(folder):
        deep = len(Path(place).relative_to(folder).parts)
        folders[:] = sorted(folders) if deep < _DEEPEST else []
        for name in sorted(names):
            yield Path(place, name)
            count += 1
            if count >= MAX_FILES:
                return


def _with_file_name(trajectories: Sequence[Trajectory], name: str) -> Iterator[Trajectory]:
    """Yield the trajectories whose columns have names, with the file name added."""
    for trajectory in trajectories:
        source = trajectory.source
        if source.columns[0].name:
            yield replace(trajectory, source=replace(source, part=f"{name} {source.part}".strip()))


def _nothing_found(path: Path, seen: Sequence[Path], refused: Sequence[str]) -> str:
    kind = (
        "WINCAPS III project" if any(file.suffix.casefold() == ".wpj" for file in (path, *seen)) else "folder"
    )
    kinds = Counter(file.suffix.casefold() or "without suffix" for file in seen)
    told = ", ".join(f"{count} {suffix}" for suffix, count in kinds.most_common(_MAX_KINDS))
    rest = f" and {counted(len(kinds) - _MAX_KINDS, 'other kind')}" if len(kinds) > _MAX_KINDS else ""
    reasons = f"; {'; '.join(refused[:_MAX_REASONS])}" if refused else ""
    files = f"{counted(len(seen), 'file')} ({told}{rest}{reasons})" if seen else "nothing"
    return (
        f"this {kind} holds no control log that can be read, only {files}: "
        "get the control log in WINCAPS III, export it as CSV, and give that file"
    )
