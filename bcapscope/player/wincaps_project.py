"""Projects of WINCAPS III: searched for control logs that can be read.

What a project stores of a log itself is described nowhere that is public, so it is not guessed: exports lying
in the project are found, and where there are none, what was seen is told with what to export.
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
"""Files of a folder that are looked at."""

MAX_TRAJECTORIES = 64
"""Trajectories of a folder that are read; nobody chooses from more."""

_DEEPEST = 8
_SUFFIXES = frozenset((".csv", ".tsv", ".txt", ".log", ".json", ".yaml", ".yml"))
_MAX_KINDS, _MAX_REASONS = 8, 3


def is_project(path: Path) -> bool:
    """Tell whether a path is a folder, or the file of a project."""
    try:
        return path.is_dir() or (path.suffix.casefold() == ".wpj" and path.is_file())
    except ValueError:  # no path at all, as the reader of files will say
        return False


def read_project(path: Path, read_file: FileReader) -> tuple[Trajectory, ...]:
    """Read every log in a project.

    Args:
        path: its folder, or its file.
        read_file: reads one file.

    Returns:
        What was found, by file, up to `MAX_TRAJECTORIES` and what the last file has beyond. A table without
        titles is no log, since anything may stand in one; nor is a capture, which is nobody's export.

    Raises:
        TrajectoryError: there is none; tells what there is and what to export.
        OSError: the folder cannot be read.
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
    """Yield the files in a folder and below, in order, without following links."""
    os.scandir(folder).close()  # says why where it cannot be read, which walking does not
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
    """Yield the trajectories whose columns are known by more than their number, with the name of the file."""
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
