"""Projects of WINCAPS III: search for control logs that can be read.

No public source describes how a project stores a log itself, so bcapscope does not guess, and looks for
exported logs in the project. If there are none, the error lists the project's files and says what to export.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.messages.places import Count, Enumeration
from bcapscope.player.trajectory import Trajectory, TrajectoryError

FileReader: TypeAlias = Callable[[Path], tuple[Trajectory, ...]]

MAX_FILES = 5000
"""Maximum number of files in a folder that are examined."""

MAX_TRAJECTORIES = 64
"""Maximum number of trajectories read from a folder; a longer list would be of no use to the user."""

_DEEPEST = 8
_SUFFIXES = frozenset((".csv", ".tsv", ".txt", ".log", ".json", ".yaml", ".yml"))
_MAX_KINDS, _MAX_REASONS = 8, 3


def is_project(path: Path) -> bool:
    """Return whether a path is a folder or a project file."""
    try:
        return path.is_dir() or (path.suffix.casefold() == ".wpj" and path.is_file())
    except ValueError:  # the path is invalid; the file reader reports that
        return False


def read_project(path: Path, read_file: FileReader) -> tuple[Trajectory, ...]:
    """Read every control log in a project, given as its folder or file.

    Reading stops after the file that reaches `MAX_TRAJECTORIES`. A table without titles is not read as a log,
    because its meaning is unknown. A capture is not read either, because WINCAPS III exports no captures.

    Raises:
        TrajectoryError: There is no control log; the message lists the project's files and says what to
            export.
        OSError: The folder cannot be read.
    """
    folder = path if path.is_dir() else path.parent
    found: list[Trajectory] = []
    seen: list[Path] = []
    refused: list[Message] = []
    for file in _files(folder):
        seen.append(file)
        if len(found) < MAX_TRAJECTORIES and file.suffix.casefold() in _SUFFIXES:
            name = str(file.relative_to(folder))
            try:
                found += _with_file_name(read_file(file), name)
            except (BcapError, OSError) as error:
                reason = os_reason(error) if isinstance(error, OSError) else error.message
                refused.append(Message("file.not-written", path=name, reason=reason))
    if not found:
        raise TrajectoryError(_nothing_found(path, seen, refused))
    return tuple(found)


def _files(folder: Path) -> Iterator[Path]:
    """Yield the files in a folder and its subfolders, in order, without following links."""
    os.scandir(folder).close()  # scandir raises if the folder is unreadable; os.walk does not
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
    """Yield the trajectories whose columns have names, and add the file name to their source."""
    for trajectory in trajectories:
        source = trajectory.source
        part = Message.from_table("text", name)
        if source.part is not None:
            part = Message("trajectory.part.of-file", file=name, part=source.part)
        if source.columns[0].name:
            yield replace(trajectory, source=replace(source, part=part))


def _nothing_found(path: Path, seen: Sequence[Path], refused: Sequence[Message]) -> Message:
    is_project = any(file.suffix.casefold() == ".wpj" for file in (path, *seen))
    kind = "project" if is_project else "folder"
    if not seen:
        return Message(f"trajectory.no-log.{kind}.empty")
    suffixes = Counter(file.suffix.casefold() for file in seen)
    kinds = [
        Message("project.files-of-kind", count=count, suffix=suffix)
        if suffix
        else Message("project.files-without-suffix", count=count)
        for suffix, count in suffixes.most_common(_MAX_KINDS)
    ]
    if len(suffixes) > _MAX_KINDS:
        kinds.append(Message("project.other-kinds", kinds=Count(len(suffixes) - _MAX_KINDS, "other-kind")))
    files = Message("project.files", files=Count(len(seen), "file"), kinds=Enumeration(tuple(kinds)))
    if refused:
        reasons = Enumeration(tuple(refused[:_MAX_REASONS]))
        return Message(f"trajectory.no-log.{kind}.refused", files=files, reasons=reasons)
    return Message(f"trajectory.no-log.{kind}", files=files)
