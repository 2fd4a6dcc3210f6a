"""Write captured trajectories as files that `play` can read: CSV, or JSON with details of the session.

The CSV is comma-separated UTF-8 text without a byte order mark, quotes or comments. Lines end in LF. Numbers
have a decimal point; `nan`, `inf` and `-inf` are possible. Numbers have enough digits to restore the
client's value exactly. A missing value is an empty cell (null in JSON). Programs should find columns by name:

``time_s``
    Time at which the client first sent the set point, in seconds since the first set point in the file.
``J1_deg`` … ``J8_deg``, or ``X_mm``, ``Y_mm``, ``Z_mm``, ``Rx_deg``, ``Ry_deg``, ``Rz_deg``, ``Fig``, or
``X_mm``, ``Y_mm``, ``Z_mm``, ``Ox``, ``Oy``, ``Oz``, ``Ax``, ``Ay``, ``Az``, ``Fig``
    The commanded pose, with as many axes as the client sent. A capture does not show which joints are linear
    axes. Values of linear axes are in mm, although the column name says degrees.
``returned_J1_deg`` and so on
    The pose in the accepted reply.
``reply_s``
    Time of the accepted reply, counted like ``time_s``.
``controller_time_ms``
    The controller's time stamp. The time stamp wraps, because the controller sends a signed 32-bit number of
    ms or µs. If the replies have no time stamps, the file has no column ``controller_time_ms``.
``retries``, ``hresult``, ``call``
    Number of retries, unsigned result code, and number of the call in the output of `bcapscope calls`.

The JSON object has the column names of the CSV in `columns`, an array of values for each set point in `rows`,
and the number of set points in `points`. NaN and infinities are strings.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import orjson

from bcapscope.analysis.slave.captured_trajectory import CapturedTrajectory, TrajectoryStep
from bcapscope.analysis.slave.slave_session import AcceptedFormat
from bcapscope.render.json_values import conversation_object, json_number, text_fragment, time_fragment
from bcapscope.render.number import number_text, numbers_text
from bcapscope.render.timestamp import epoch_text, utc_text

FORMAT = "bcapscope trajectory 1"  # value of the member ``format`` in the JSON


class CsvTrajectoryWriter:
    """Writes one trajectory as CSV. Call `head` first, `rows` any number of times, and `tail` last."""

    def __init__(self, trajectory: CapturedTrajectory) -> None:
        self._trajectory = trajectory
        self._empty_pose = "," * (len(trajectory.axes) - 1)

    def head(self) -> bytes:
        return ",".join(column_names(self._trajectory)).encode("ascii") + b"\n"

    def rows(self, steps: Sequence[TrajectoryStep]) -> bytes:
        return "".join(self._lines(steps)).encode("ascii")

    def tail(self) -> bytes:
        return b""

    def _lines(self, steps: Sequence[TrajectoryStep]) -> Iterator[str]:
        start, stamped = self._trajectory.start, self._trajectory.has_stamps
        for step in steps:
            replied = "" if step.reply_time is None else epoch_text(step.reply_time - start)
            returned = numbers_text(step.returned) if step.returned else self._empty_pose
            stamp = ("" if step.stamp is None else number_text(step.stamp)) + "," if stamped else ""
            yield (
                f"{epoch_text(step.time - start)},{numbers_text(step.commanded)},{returned},{replied},"
                f"{stamp}{step.retries},{'' if step.hresult is None else step.hresult},{step.call}\n"
            )


class JsonTrajectoryWriter:
    """Writes one trajectory as JSON. Call `head` first, `rows` any number of times, and `tail` last."""

    def __init__(self, trajectory: CapturedTrajectory) -> None:
        self._trajectory = trajectory
        self._empty_pose = ",".join(["null"] * len(trajectory.axes)).encode("ascii")
        self._point_count = 0

    def head(self) -> bytes:
        return _header(self._trajectory)[:-1] + b',"rows":['

    def rows(self, steps: Sequence[TrajectoryStep]) -> bytes:
        begun, self._point_count = bool(self._point_count), self._point_count + len(steps)
        text = b",\n".join(self._arrays(steps))
        return (b",\n" if begun and text else b"\n" if text else b"") + text

    def tail(self) -> bytes:
        return b'\n],"points":%d}\n' % self._point_count

    def _arrays(self, steps: Sequence[TrajectoryStep]) -> Iterator[bytes]:
        start, stamped = self._trajectory.start, self._trajectory.has_stamps
        for step in steps:
            yield b"[%b,%b,%b,%b,%b%d,%b,%d]" % (
                epoch_text(step.time - start).encode("ascii"),
                json_number(step.commanded)[1:-1],
                json_number(step.returned)[1:-1] if step.returned else self._empty_pose,
                b"null" if step.reply_time is None else epoch_text(step.reply_time - start).encode("ascii"),
                b"%b," % (b"null" if step.stamp is None else json_number(step.stamp)) if stamped else b"",
                step.retries,
                b"null" if step.hresult is None else b"%d" % step.hresult,
                step.call,
            )


def column_names(trajectory: CapturedTrajectory) -> list[str]:
    axes = [f"{axis.name}_{axis.unit}" if axis.unit else axis.name for axis in trajectory.axes]
    stamps = ["controller_time_ms"] if trajectory.has_stamps else []
    returned = [f"returned_{name}" for name in axes]
    return ["time_s", *axes, *returned, "reply_s", *stamps, "retries", "hresult", "call"]


def _header(trajectory: CapturedTrajectory) -> bytes:
    mode, known_by = trajectory.mode, trajectory.mode.generation_known_by
    return orjson.dumps(
        {
            "format": FORMAT,
            "stay": trajectory.session_number,
            **conversation_object(trajectory.conversation),
            "robot": trajectory.robot,
            "start": time_fragment(trajectory.start),
            "start_utc": utc_text(trajectory.start),
            "mode": mode.value,
            "mode_text": text_fragment(None if mode.meaning is None else mode.meaning.text),
            "mode_guessed": mode.guessed,
            "pose_type": mode.pose_type,
            "generation": mode.generation,
            "generation_known_by": text_fragment(None if known_by is None else str(known_by)),
            "send_format": _format(trajectory.send_format),
            "receive_format": _format(trajectory.receive_format),
            "interval_ms": trajectory.grid_ms,
            "axes": [{"name": axis.name, "unit": axis.unit} for axis in trajectory.axes],
            "columns": column_names(trajectory),
        }
    )


def _format(found: AcceptedFormat | None) -> int | None:
    return None if found is None else found.value
