"""Reading trajectories from files: which kind it is, and its text or bytes for the reader of that kind.

This is the only module of the player that opens files to read set points. What it reads is never trusted:
sizes are bounded, and whatever is in a file gives trajectories or one `TrajectoryError`.
"""

from __future__ import annotations

import codecs
import io
import os
import stat
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
import orjson

from bcapscope.capture.file import open_capture
from bcapscope.capture.pcap import MAGICS
from bcapscope.capture.pcapng import MAGIC
from bcapscope.capture.sides import PORTS
from bcapscope.capture.source import GZIP_MAGIC
from bcapscope.errors import CaptureError
from bcapscope.player.layout import Wishes
from bcapscope.player.project import is_project, search
from bcapscope.player.records import MOST_VALUES, TOO_MANY_VALUES, read_records
from bcapscope.player.slvmoves import read_capture
from bcapscope.player.table import read_table
from bcapscope.player.trajectory import Source, Trajectory, TrajectoryError
from bcapscope.player.yamltext import read_yaml

LARGEST = 1 << 30
"""Bytes of a table: two hours of a log with 73 columns."""

LARGEST_OBJECT = 24 << 20
"""Bytes of JSON or YAML, which is in memory as a whole, at up to 24 times its size; see `MOST_VALUES`."""

LONGEST_LINE = 1 << 16

_HEAD = 4096
_YAML = (".yaml", ".yml")
_FOREIGN = {
    b"PK\x03\x04": "a ZIP archive or an Excel workbook: save the sheet as CSV",
    b"\xd0\xcf\x11\xe0": "an old Excel workbook or another OLE file: save the sheet as CSV",
    b"\x89MCAP": "an MCAP recording: write its trajectory as JSON or YAML",
    b"SQLite format 3": "an SQLite database, such as a ROS 2 bag: write its trajectory as JSON or YAML",
    b"#ROSBAG": "a ROS 1 bag: write its trajectory as JSON or YAML",
    b"\x93NUMPY": "a NumPy array: write it with numpy.savetxt",
    b"%PDF": "a PDF document",
}
_ENCODINGS = (("utf-8", "UTF-8"), ("cp932", "Shift-JIS (cp932)"))
_MARKED = (
    (codecs.BOM_UTF8, "utf-8-sig", "UTF-8 with byte order mark"),
    (codecs.BOM_UTF16_LE, "utf-16", "UTF-16"),
    (codecs.BOM_UTF16_BE, "utf-16", "UTF-16"),
)


def read(
    path: str | os.PathLike[str], wishes: Wishes | None = None, ports: Collection[int] = PORTS
) -> tuple[Trajectory, ...]:
    """Read the trajectories of a file or a WINCAPS III project.

    Args:
        path: of a table (CSV, TSV, numbers with spaces between; UTF-8, UTF-16 or Shift-JIS), of what
            `bcapscope extract` wrote, of a JointTrajectory as JSON or YAML, of a capture, or of a project,
            its folder or its .wpj file.
        wishes: what the user says of it.
        ports: where controllers listen, for captures.

    Returns:
        One or several: stays in slave mode, messages, runs of records, logs of a project.

    Raises:
        TrajectoryError: there is none that can be read; why is told in one sentence.
    """
    wishes = wishes or Wishes()
    try:
        with np.errstate(all="ignore"):  # absurd numbers are for the pre-flight to tell
            if is_project(Path(path)):
                return search(Path(path), lambda file: _read_file(file, wishes, ports))
            return _read_file(Path(path), wishes, ports)
    except OSError as error:
        raise TrajectoryError(f"cannot be read: {error.strerror or error}") from error
    except CaptureError as error:
        raise TrajectoryError(str(error)) from error


def _read_file(path: Path, wishes: Wishes, ports: Collection[int]) -> tuple[Trajectory, ...]:
    with _open(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > LARGEST:
            raise TrajectoryError(f"larger than {LARGEST >> 20} MB")
        head = stream.read(_HEAD)
        if not head:
            raise TrajectoryError("the file is empty")
        if head[:4] == MAGIC or head[:4] in MAGICS or head.startswith(GZIP_MAGIC):
            return _read_capture(path, wishes, ports)
        _refuse_foreign(head)
        stream.seek(0)
        if path.suffix.casefold() in _YAML:
            return read_records(list(read_yaml(_whole(stream, size))), Source(str(path), "YAML"), wishes)
        if head.lstrip(codecs.BOM_UTF8 + b" \t\r\n")[:1] == b"{" or path.suffix.casefold() == ".json":
            return read_records(_json(_whole(stream, size)), Source(str(path), "JSON"), wishes)
        return _read_text(stream, path, head, wishes)


def _open(path: Path) -> BinaryIO:
    """Open a regular file; a pipe or a device would keep us waiting.

    Raises:
        TrajectoryError: it is none.
        OSError: it cannot be opened.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise TrajectoryError("this is no file")
        return path.open("rb")
    except ValueError as error:
        if isinstance(error, TrajectoryError):
            raise
        raise TrajectoryError("this is no name of a file") from error


def _read_capture(path: Path, wishes: Wishes, ports: Collection[int]) -> tuple[Trajectory, ...]:
    with open_capture(path) as capture:
        return read_capture(capture, Source(str(path), ""), wishes, ports)


def _refuse_foreign(head: bytes) -> None:
    for magic, told in _FOREIGN.items():
        if head.startswith(magic):
            raise TrajectoryError(f"this is {told}")
    if b"\0" in head and not head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise TrajectoryError("this is a binary file of a kind that is not known")


def _whole(stream: BinaryIO, size: int) -> bytes:
    if size > LARGEST_OBJECT:
        raise TrajectoryError(
            f"larger than {LARGEST_OBJECT >> 20} MB, the limit for JSON and YAML: write a table (CSV)"
        )
    return stream.read(LARGEST_OBJECT + 1)


def _json(data: bytes) -> list[object]:
    if sum(map(data.count, (b",", b"[", b"{"))) > MOST_VALUES:  # each value has one of these before it
        raise TrajectoryError(TOO_MANY_VALUES)
    try:
        return [orjson.loads(data.removeprefix(codecs.BOM_UTF8))]
    except orjson.JSONDecodeError as error:
        raise TrajectoryError(f"this is no JSON: {error.msg}", error.lineno, error.colno) from error


def _read_text(stream: BinaryIO, path: Path, head: bytes, wishes: Wishes) -> tuple[Trajectory, ...]:
    marked = [(encoding, name) for mark, encoding, name in _MARKED if head.startswith(mark)]
    for encoding, name in marked or _ENCODINGS:
        stream.seek(0)
        text = io.TextIOWrapper(stream, encoding, newline="")
        try:
            return read_table(_lines(text), Source(str(path), name), wishes)
        except UnicodeError:
            continue
        finally:
            text.detach()
    raise TrajectoryError(f"this is no text in {' or '.join(name for _, name in marked or _ENCODINGS)}")


def _lines(text: io.TextIOWrapper) -> Iterator[str]:
    number = 0
    while line := text.readline(LONGEST_LINE + 1):
        number += 1
        if len(line) > LONGEST_LINE:
            raise TrajectoryError(f"the line is longer than {LONGEST_LINE} characters", number)
        yield line
