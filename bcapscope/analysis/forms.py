"""Numbers of many frames at once.

Set points of a session differ in serial, reserved and the numbers inside their arguments, nothing else. A
form is learnt from one frame that was decoded in full and found sound; all that agree with it byte for byte
outside those places are read as columns.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from bcapscope.analysis.batch import Bodies
from bcapscope.analysis.distribution import Bools
from bcapscope.protocol.arguments import Argument, Number
from bcapscope.protocol.content import Content, Framing
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.layout import Layout, taken_by_each
from bcapscope.protocol.variant import Variant

MOST_FORMS = 16
"""Forms kept for one direction of a stay; frames of more than that are read one by one."""

MOST_NUMBERS = 256
"""Frames with more numbers than that are read one by one; a set point has a dozen."""

_SERIAL_AND_RESERVED = slice(5, 9)

Picked: TypeAlias = "tuple[Sequence[float], float | None]"
"""A pose and a time stamp, or positions of their numbers."""


@dataclass(frozen=True, slots=True)
class Picker:
    """How to find what is wanted in a frame's argument.

    Attributes:
        argument: index of the argument.
        pick: takes the argument's value and returns pose and time stamp: the pose is empty and the stamp None
            where there is none. Called also with a value of the same form in which each number is its own
            place among the numbers, so that it must choose by form alone.
    """

    argument: int
    pick: Callable[[Variant], Picked]


class Columns:
    """Poses and time stamps, a row a frame; NaN where a frame has none.

    Attributes:
        poses: as many columns as were asked for.
        posed: whether a row has a pose with all of them.
        stamps: of the controller.
    """

    __slots__ = ("posed", "poses", "stamps")

    def __init__(self, rows: int, axes: int) -> None:
        self.poses = np.full((rows, axes), np.nan)
        self.posed = np.zeros(rows, np.bool_)
        self.stamps = np.full(rows, np.nan)


class _Form:
    """One form: its bytes, which of them may differ, and where pose and stamp stand."""

    __slots__ = ("_fields", "_fixed", "_pose", "_stamp", "_template")

    def __init__(self, raw: bytes, spans: Sequence[Number], pose: Sequence[int], stamp: int | None) -> None:
        fixed = np.full(len(raw), 0xFF, np.uint8)
        fixed[_SERIAL_AND_RESERVED] = 0
        places = list(_places(spans))
        for start, code in places:
            fixed[start : start + struct.calcsize(f"<{code}")] = 0
        self._fixed = fixed
        self._template = np.frombuffer(raw, np.uint8)
        self._fields = np.dtype(
            {
                "names": [str(index) for index in range(len(places))],
                "formats": [_NUMPY_CODES.get(code, f"S{code[:-1]}") for _, code in places],
                "offsets": [start for start, _ in places],
                "itemsize": len(raw),
            }
        )
        self._pose = [str(index) for index in pose]
        self._stamp = None if stamp is None else str(stamp)

    def agrees(self, data: NDArray[np.uint8]) -> Bools | None:
        """Tell which rows of bytes have this form; None for all."""
        off = (data ^ self._template) & self._fixed
        return ~np.logical_or.reduce(off != 0, axis=1) if off.any() else None

    def read(self, data: NDArray[np.uint8], rows: NDArray[np.int64], columns: Columns) -> None:
        """Put the numbers of `data`, all of this form, into `rows` of `columns`."""
        records = np.ascontiguousarray(data).view(self._fields)[:, 0]
        if len(self._pose) >= columns.poses.shape[1]:
            columns.posed[rows] = True
            for axis, name in enumerate(self._pose[: columns.poses.shape[1]]):
                columns.poses[rows, axis] = records[name]
        if self._stamp is not None:
            columns.stamps[rows] = records[self._stamp]


class Forms:
    """Reads frames of one direction of a stay."""

    def __init__(self, picker: Picker) -> None:
        self._picker = picker
        self._forms: dict[int, list[_Form]] = {}
        self._learnt = 0

    def read(self, bodies: Bodies, count: int, axes: int) -> Columns:
        """Read `count` frames, each with at least a header; `axes` numbers of each pose are wanted."""
        columns = Columns(count, axes)
        rows = np.arange(count)
        if bodies.size:
            data = np.frombuffer(bodies.data, np.uint8).reshape(count, bodies.size)
            if bodies.others:
                rows = np.delete(rows, list(bodies.others))
                data = data[rows]
            self._read_equally_long(data, rows, columns)
        by_length: dict[int, list[int]] = {}
        for place, raw in bodies.others.items():
            by_length.setdefault(len(raw), []).append(place)
        for length, places in by_length.items():
            if length:
                raws = b"".join(bodies.others[place] for place in places)
                data = np.frombuffer(raws, np.uint8).reshape(-1, length)
                self._read_equally_long(data, np.array(places), columns)
        return columns

    def _read_equally_long(self, data: NDArray[np.uint8], rows: NDArray[np.int64], columns: Columns) -> None:
        tried = 0
        while len(rows):
            forms = self._forms.setdefault(data.shape[1], [])
            if tried == len(forms) and not self._learn(data[0].tobytes(), forms):
                self._read_single(data[0].tobytes(), int(rows[0]), columns)
                data, rows = data[1:], rows[1:]
                continue
            agrees = forms[tried].agrees(data)
            if agrees is None:
                forms[tried].read(data, rows, columns)
                return
            forms[tried].read(data[agrees], rows[agrees], columns)
            data, rows = data[~agrees], rows[~agrees]
            tried += 1

    def _learn(self, raw: bytes, forms: list[_Form]) -> bool:
        """Add the form of a frame; False for a frame with problems, and when there are forms enough."""
        if self._learnt >= MOST_FORMS:
            return False
        content = Content(raw)
        if content.problems or content.framing is not Framing.PLAIN:
            return False
        if sum(span.repeat for span in content.numbers if span.code != "s") > MOST_NUMBERS:
            return False
        arguments = content.arguments
        first = arguments[0].stop if len(arguments) > 1 else 0
        spans = [span for span in content.numbers if span.repeat and span.start >= first]
        pose, stamp = self._find(raw, arguments, tuple(_places(spans)))
        forms.append(_Form(raw, spans, [int(index) for index in pose], None if stamp is None else int(stamp)))
        self._learnt += 1
        return True

    def _find(self, raw: bytes, arguments: tuple[Argument, ...], places: Sequence[tuple[int, str]]) -> Picked:
        """Let the picker choose among numbers that are their own places."""
        if sum(taken_by_each(arguments)) != len(places) or self._picker.argument >= len(arguments):
            return (), None
        numbered = tuple(
            raw[start : start + struct.calcsize(code)] if "s" in code else index
            for index, (start, code) in enumerate(places)
        )
        return self._picker.pick(Layout(arguments).arguments(numbered)[self._picker.argument].variant)

    def _read_single(self, raw: bytes, row: int, columns: Columns) -> None:
        arguments = Frame(raw).arguments
        if self._picker.argument >= len(arguments):
            return
        pose, stamp = self._picker.pick(arguments[self._picker.argument].variant)
        axes = columns.poses.shape[1]
        if len(pose) >= axes:
            columns.posed[row] = True
            columns.poses[row] = pose[:axes]
        if stamp is not None:
            columns.stamps[row] = stamp


_NUMPY_CODES = {
    "B": "u1",
    "h": "<i2",
    "H": "<u2",
    "i": "<i4",
    "I": "<u4",
    "q": "<i8",
    "Q": "<u8",
    "f": "<f4",
    "d": "<f8",
}


def _places(spans: Sequence[Number]) -> Iterator[tuple[int, str]]:
    """Yield where each number stands and its format; the data of a UI1 array is one."""
    for start, code, repeat in spans:
        if code == "s":
            yield start, f"{repeat}s"
            continue
        width = struct.calcsize(f"<{code}")
        for index in range(repeat):
            yield start + index * width, code
