"""Read trajectories from files. Files are not trusted: their size is limited, and wrong content of any kind
raises `TrajectoryError`.

No public source describes how a WINCAPS III project stores its logs. bcapscope therefore reads only logs that
were exported into the project.
"""

from __future__ import annotations

import codecs
import io
import os
import stat
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
import orjson

from bcapscope.capture.byte_source import GZIP_MAGIC
from bcapscope.capture.pcap import MAGICS
from bcapscope.capture.pcapng import MAGIC
from bcapscope.errors import BcapError, CaptureError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.messages.places import Count, Enumeration
from bcapscope.player.capture_trajectories import read_capture
from bcapscope.player.column_layout import ReadOptions
from bcapscope.player.trajectory import Trajectory, TrajectoryError, TrajectorySource
from bcapscope.player.trajectory_documents import MAX_VALUES, TOO_MANY_VALUES, read_documents, read_yaml
from bcapscope.player.trajectory_table import read_table

MAX_TABLE_SIZE = 1 << 30
"""Size in bytes of the largest table that bcapscope reads: two hours of a log with 73 columns."""

MAX_OBJECT_SIZE = 24 << 20
"""Size in bytes of the largest JSON or YAML file. Reading a file takes up to 24 times its size in memory."""

LONGEST_LINE = 1 << 16

MAX_FILES = 5000
"""Maximum number of files to examine in a folder."""

MAX_TRAJECTORIES = 64
"""Maximum number of trajectories to read from a folder; a longer list would not help the user."""

_DEEPEST = 8
_SUFFIXES = frozenset((".csv", ".tsv", ".txt", ".log", ".json", ".yaml", ".yml"))
_MAX_KINDS, _MAX_REASONS = 8, 3

_HEAD = 4096
_YAML = (".yaml", ".yml")
_FOREIGN = {
    b"PK\x03\x04": "trajectory.foreign.zip",
    b"\xd0\xcf\x11\xe0": "trajectory.foreign.ole",
    b"\x89MCAP": "trajectory.foreign.mcap",
    b"SQLite format 3": "trajectory.foreign.sqlite",
    b"#ROSBAG": "trajectory.foreign.rosbag",
    b"\x93NUMPY": "trajectory.foreign.numpy",
    b"%PDF": "trajectory.foreign.pdf",
}
_ENCODINGS = (("utf-8", "UTF-8"), ("cp932", "Shift-JIS (cp932)"))
_BOM_ENCODINGS = (
    (codecs.BOM_UTF8, "utf-8-sig", "UTF-8 with byte order mark"),
    (codecs.BOM_UTF16_LE, "utf-16", "UTF-16"),
    (codecs.BOM_UTF16_BE, "utf-16", "UTF-16"),
)


def read_trajectories(
    path: str | os.PathLike[str], options: ReadOptions | None = None
) -> tuple[Trajectory, ...]:
    """Read the trajectories of a file or of a WINCAPS III project, given as its folder or its .wpj file.

    A file is a table (CSV, TSV, numbers separated by spaces; UTF-8, UTF-16 or Shift-JIS), output of
    `bcapscope extract`, a JointTrajectory as JSON or YAML, or a capture. Returns one trajectory per
    slave-mode session of a capture, per message of a ROS file, or per control log of a project. A table is
    split where records are missing, and each part is a trajectory.
    """
    options = options or ReadOptions()
    try:
        # numpy does not warn about absurd numbers here, because the pre-flight check reports them
        with np.errstate(all="ignore"):
            place = Path(path)
            is_project_file = place.suffix.casefold() == ".wpj" and place.is_file()
            read = _read_project if place.is_dir() or is_project_file else _read_file
            return read(place, options)
    except OSError as error:
        raise TrajectoryError(Message("trajectory.cannot-read", reason=os_reason(error))) from error
    except CaptureError as error:
        raise TrajectoryError(error.message) from error


def _read_file(path: Path, options: ReadOptions) -> tuple[Trajectory, ...]:
    with _open_regular_file(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > MAX_TABLE_SIZE:
            raise TrajectoryError(Message("trajectory.too-large", size=MAX_TABLE_SIZE >> 20))
        head = stream.read(_HEAD)
        if not head:
            raise TrajectoryError(Message("trajectory.file-empty"))
        if head[:4] == MAGIC or head[:4] in MAGICS or head.startswith(GZIP_MAGIC):
            return read_capture(TrajectorySource(str(path)), options)
        _refuse_foreign(head)
        stream.seek(0)
        if path.suffix.casefold() in _YAML:
            documents = list(read_yaml(_read_whole(stream, size)))
            return read_documents(documents, _source(path, "YAML"), options)
        if head.lstrip(codecs.BOM_UTF8 + b" \t\r\n")[:1] == b"{" or path.suffix.casefold() == ".json":
            documents = _parse_json(_read_whole(stream, size))
            return read_documents(documents, _source(path, "JSON"), options)
        return _read_text(stream, path, head, options)


def _open_regular_file(path: Path) -> BinaryIO:
    """Open a file. Refuse pipes and devices, because reading them could block."""
    try:
        status = path.stat()
    except ValueError as error:
        raise TrajectoryError(Message("trajectory.no-file-name")) from error
    if not stat.S_ISREG(status.st_mode):
        raise TrajectoryError(Message("trajectory.no-file"))
    return path.open("rb")


def _refuse_foreign(head: bytes) -> None:
    for magic, id in _FOREIGN.items():
        if head.startswith(magic):
            raise TrajectoryError(Message("trajectory.foreign", what=Message(id)))
    if b"\0" in head and not head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise TrajectoryError(Message("trajectory.binary"))


def _read_whole(stream: BinaryIO, size: int) -> bytes:
    if size > MAX_OBJECT_SIZE:
        raise TrajectoryError(Message("trajectory.document-too-large", size=MAX_OBJECT_SIZE >> 20))
    return stream.read(MAX_OBJECT_SIZE + 1)


def _parse_json(data: bytes) -> list[object]:
    # In a JSON list or object, each value has its own `,`, `[` or `{` before it.
    if sum(map(data.count, (b",", b"[", b"{"))) > MAX_VALUES:
        raise TrajectoryError(TOO_MANY_VALUES)
    try:
        return [orjson.loads(data.removeprefix(codecs.BOM_UTF8))]
    except orjson.JSONDecodeError as error:
        raise TrajectoryError(
            Message("trajectory.no-json", reason=error.msg), error.lineno, error.colno
        ) from error


def _read_text(stream: BinaryIO, path: Path, head: bytes, options: ReadOptions) -> tuple[Trajectory, ...]:
    marked = [(encoding, name) for mark, encoding, name in _BOM_ENCODINGS if head.startswith(mark)]
    for encoding, name in marked or _ENCODINGS:
        stream.seek(0)
        text = io.TextIOWrapper(stream, encoding, newline="")
        try:
            return read_table(_lines(text), _source(path, name), options)
        except UnicodeError:
            continue
        finally:
            text.detach()
    names = [name for _, name in marked or _ENCODINGS]
    raise TrajectoryError(Message("trajectory.no-text", encodings=" or ".join(names)))


def _source(path: Path, encoding: str) -> TrajectorySource:
    return TrajectorySource(str(path), Message.from_table("text", encoding))


def _lines(text: io.TextIOWrapper) -> Iterator[str]:
    number = 0
    while line := text.readline(LONGEST_LINE + 1):
        number += 1
        if len(line) > LONGEST_LINE:
            raise TrajectoryError(Message("trajectory.long-line", limit=LONGEST_LINE), number)
        yield line


def _read_project(path: Path, options: ReadOptions) -> tuple[Trajectory, ...]:
    """Read every control log that WINCAPS III exported to the folder of a project. Ignore tables without
    titles, because their meaning is unknown. Ignore packet captures too: WINCAPS III never writes one.
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
                found += _with_file_name(_read_file(file, options), name)
            except (BcapError, OSError) as error:
                reason = os_reason(error) if isinstance(error, OSError) else error.message
                refused.append(Message("file.not-written", path=name, reason=reason))
    if not found:
        raise TrajectoryError(_nothing_found(path, seen, refused))
    return tuple(found)


def _files(folder: Path) -> Iterator[Path]:
    """Yield the files in a folder and its subfolders, in order, without following links."""
    os.scandir(folder).close()  # unlike os.walk, scandir raises an error if the folder is unreadable
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
    """Yield each trajectory that has column names, with the file name in its `Trajectory.source`."""
    for trajectory in trajectories:
        source = trajectory.source
        part = Message.from_table("text", name)
        if source.part is not None:
            part = Message("trajectory.part.of-file", file=name, part=source.part)
        if source.columns[0].name:
            yield replace(trajectory, source=replace(source, part=part))


def _nothing_found(path: Path, seen: Sequence[Path], refused: Sequence[Message]) -> Message:
    has_project_file = any(file.suffix.casefold() == ".wpj" for file in (path, *seen))
    kind = "project" if has_project_file else "folder"
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
