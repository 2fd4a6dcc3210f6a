"""The controller's own log of a motion, saved as CSV.

The sample others/Get_Syslog.py in ShoheiKobata/orin_bcap_python_samples shows the values that GetLogRecord
returns, and their order. The titles of the CSV columns also come from Get_Syslog.py.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from bcapscope.client.controller_target import DEFAULT_RETRY_POLICIES, ControllerTarget
from bcapscope.client.object_opener import ObjectOpener
from bcapscope.client.remote_objects import Robot
from bcapscope.client.session import Session
from bcapscope.player.blocking_caller import BlockingCaller, open_channel, run_blocking
from bcapscope.protocol.codec.variant import Value
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.protocol.text_format import is_spreadsheet_formula

_AXES = ("指令値", "エンコーダ値", "電流値", "負荷率")
_REST = (
    "ユーザデータ",
    "プログラム管理番号",
    "ファイル名",
    "行番号",
    "コントローラ起動時からのカウンタ",
    "ツール番号",
    "ワーク番号",
)

LOG_COLUMN_TITLES = tuple(f"[J{axis} - {what}]" for axis in range(1, 9) for what in _AXES) + tuple(
    f"[{title}]" for title in _REST
)
"""Titles for each axis: set point, encoder, motor current and load. Further titles: user data, program
number, file name, line number, counter, tool, work.
"""


@contextmanager
def open_new_file(path: str | None) -> Iterator[BinaryIO | None]:
    """Open a new file. At the end, delete the file if it is empty. Without a path, yield None."""
    if path is None:
        yield None
        return
    file = open(path, "xb")  # noqa: SIM115 - with `with`, an error of close() would be raised
    try:
        yield file
    finally:
        is_empty = not file.tell()
        with suppress(OSError):  # the code that wrote the file has already flushed it and handled errors
            file.close()
        if is_empty:
            Path(path).unlink(missing_ok=True)


async def read_log_records(
    session: Session, target: ControllerTarget, robot_name: str, check_abort: Callable[[], None]
) -> list[Value]:
    records: list[Value] = []
    try:
        opener = ObjectOpener(session, target, {ObjectClass.ROBOT: robot_name})
        robot = await opener.open_remote(Robot)
        count = await robot.execute("GetLogCount")
        for index in range(count if isinstance(count, int) else 0):
            check_abort()
            records.append(await robot.execute("GetLogRecord", index))
        return records
    finally:
        await session.close()


def read_control_log(target: ControllerTarget, robot: str, check_abort: Callable[[], None]) -> list[Value]:
    """Return the controller's log records, oldest first, or raise the exceptions of `Session.call`.

    The player opens a separate TCP connection, because a record of 39 values exceeds a datagram of 503 bytes.
    """
    channel = open_channel(target.host, target.port, tcp=True)
    caller = BlockingCaller(channel, target.convention_for(datagrams=False))
    session = Session(caller, DEFAULT_RETRY_POLICIES)
    return run_blocking(read_log_records(session, target, robot, check_abort))


def _csv_cell(value: object) -> object:
    """Put an apostrophe before text that a spreadsheet would execute as a formula."""
    return f"'{value}" if isinstance(value, str) and is_spreadsheet_formula(value) else value


def write_control_log(file: BinaryIO, records: Sequence[Value]) -> None:
    """Write records as CSV in UTF-8, one line per record."""
    text = io.StringIO(newline="")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(LOG_COLUMN_TITLES)
    rows.writerows(map(_csv_cell, record if isinstance(record, tuple) else (record,)) for record in records)
    file.write(text.getvalue().encode(errors="backslashreplace"))
    file.flush()
