"""Read poses and time stamps from many frames in one step.

The frames of a slave-mode session's set points differ only in the serial, the reserved field and the numbers
in their arguments. `ColumnReader` therefore learns where the numbers are in one frame, and then reads all
similar frames together.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.slave.set_point_batch import FrameBytes
from bcapscope.analysis.statistics.distribution import Bools
from bcapscope.protocol.codec.arguments import NumberSpan
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.frame_content import FrameContent
from bcapscope.protocol.codec.frame_template import FrameTemplate, number_counts
from bcapscope.protocol.codec.variant import Variant

MAX_TEMPLATES = 16
"""Maximum number of templates for each direction of a session. All other frames are read one by one."""

MAX_NUMBERS = 256
"""Maximum number of numbers in a template. A set point has about twelve numbers."""

PickedNumbers: TypeAlias = "tuple[Sequence[float], float | None]"
"""Pose and time stamp in a frame: either their values, or their indexes among all numbers of the frame."""


class PoseColumns:
    """Columns of poses and time stamps, one row per frame; a missing pose or time stamp is NaN."""

    def __init__(self, rows: int, axes: int) -> None:
        self.poses = np.full((rows, axes), np.nan)
        self.has_pose = np.zeros(rows, np.bool_)
        self.stamps = np.full(rows, np.nan)


class _ColumnTemplate:
    def __init__(self, raw: bytes, form: FrameTemplate, pose: Sequence[int], stamp: int | None) -> None:
        places = list(_number_positions(form.spans))
        self._mask = np.frombuffer(form.mask, np.uint8)
        self._template = np.frombuffer(raw, np.uint8)
        self._fields = np.dtype(
            {
                "names": [str(index) for index in range(len(places))],
                "formats": [f"S{code[:-1]}" if "s" in code else f"<{code}" for _, code in places],
                "offsets": [start for start, _ in places],
                "itemsize": len(raw),
            }
        )
        self._pose = [str(index) for index in pose]
        self._stamp = None if stamp is None else str(stamp)

    def matching_rows(self, data: NDArray[np.uint8]) -> Bools | None:
        """Return, for each row of `data`, whether the row matches this template; None if all rows match."""
        off = (data ^ self._template) & self._mask
        return ~np.logical_or.reduce(off != 0, axis=1) if off.any() else None

    def read(self, data: NDArray[np.uint8], rows: NDArray[np.int64], columns: PoseColumns) -> None:
        """Copy row `i` of `data` to row `rows[i]` of `columns`. Each row must match the template."""
        records = np.ascontiguousarray(data).view(self._fields)[:, 0]
        if len(self._pose) >= columns.poses.shape[1]:
            columns.has_pose[rows] = True
            for axis, name in enumerate(self._pose[: columns.poses.shape[1]]):
                columns.poses[rows, axis] = records[name]
        if self._stamp is not None:
            columns.stamps[rows] = records[self._stamp]


class ColumnReader:
    """Reads poses and time stamps from the frames of one direction of a slave-mode session."""

    def __init__(self, argument: int, pick: Callable[[Variant], PickedNumbers]) -> None:
        """Create a reader for the argument with the index `argument`.

        `pick` returns the argument's pose and time stamp. To learn a template, `ColumnReader` replaces each
        number in the argument with an index. Therefore `pick` must choose numbers by position, not by value.
        """
        self._argument = argument
        self._pick = pick
        self._templates: dict[int, list[_ColumnTemplate]] = {}
        self._template_count = 0

    def read(self, bodies: FrameBytes, count: int, axes: int) -> PoseColumns:
        """Read `count` frames, whose headers must be complete. A pose has `axes` numbers."""
        columns = PoseColumns(count, axes)
        rows = np.arange(count)
        if bodies.size:
            data = np.frombuffer(bodies.data, np.uint8).reshape(count, bodies.size)
            if bodies.odd_sized:
                rows = np.delete(rows, list(bodies.odd_sized))
                data = data[rows]
            self._read_equally_long(data, rows, columns)
        by_length: dict[int, list[int]] = {}
        for place, raw in bodies.odd_sized.items():
            by_length.setdefault(len(raw), []).append(place)
        for length, places in by_length.items():
            if length:
                raws = b"".join(bodies.odd_sized[place] for place in places)
                data = np.frombuffer(raws, np.uint8).reshape(-1, length)
                self._read_equally_long(data, np.array(places), columns)
        return columns

    def _read_equally_long(
        self, data: NDArray[np.uint8], rows: NDArray[np.int64], columns: PoseColumns
    ) -> None:
        index = 0
        while len(rows):
            templates = self._templates.setdefault(data.shape[1], [])
            if index == len(templates) and not self._add_template(data[0].tobytes(), templates):
                self._read_single(data[0].tobytes(), int(rows[0]), columns)
                data, rows = data[1:], rows[1:]
                continue
            agrees = templates[index].matching_rows(data)
            if agrees is None:
                templates[index].read(data, rows, columns)
                return
            templates[index].read(data[agrees], rows[agrees], columns)
            data, rows = data[~agrees], rows[~agrees]
            index += 1

    def _add_template(self, raw: bytes, templates: list[_ColumnTemplate]) -> bool:
        """Learn a template; return False if the frame has problems or there are too many templates."""
        if self._template_count >= MAX_TEMPLATES:
            return False
        content = FrameContent(raw)
        form = FrameTemplate.learn(content)
        if (
            form is None
            or sum(span.repeat for span in content.number_spans if span.code != "s") > MAX_NUMBERS
        ):
            return False
        pose, stamp = self._locate_numbers(raw, form)
        templates.append(
            _ColumnTemplate(raw, form, [int(index) for index in pose], None if stamp is None else int(stamp))
        )
        self._template_count += 1
        return True

    def _locate_numbers(self, raw: bytes, form: FrameTemplate) -> PickedNumbers:
        """Return where the pose and the time stamp are, as indexes into all numbers of the frame."""
        arguments, places = form.prototype, tuple(_number_positions(form.spans))
        if sum(number_counts(arguments)) != len(places) or self._argument >= len(arguments):
            return (), None
        numbered = tuple(
            raw[start : start + struct.calcsize(code)] if "s" in code else index
            for index, (start, code) in enumerate(places)
        )
        return self._pick(form.fill_variants(numbered)[self._argument])

    def _read_single(self, raw: bytes, row: int, columns: PoseColumns) -> None:
        arguments = Frame(raw).arguments
        if self._argument >= len(arguments):
            return
        pose, stamp = self._pick(arguments[self._argument].variant)
        axes = columns.poses.shape[1]
        if len(pose) >= axes:
            columns.has_pose[row] = True
            columns.poses[row] = pose[:axes]
        if stamp is not None:
            columns.stamps[row] = stamp


def _number_positions(spans: Sequence[NumberSpan]) -> Iterator[tuple[int, str]]:
    """Yield the offset and the format of each number. All bytes of a VT_UI1 array count as one number with a
    format such as `16s`, because bcapscope decodes the array into one `bytes` value.
    """
    for start, code, repeat in spans:
        if code == "s":
            yield start, f"{repeat}s"
            continue
        width = struct.calcsize(f"<{code}")
        for index in range(repeat):
            yield start + index * width, code
