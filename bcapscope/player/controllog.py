"""The controller's own log of a motion, saved as CSV.

StartLog and StopLog are those of DENSO Wave 2009, How to use the Slave mode; a record of GetLogRecord, its
order and the titles of the columns are those of ShoheiKobata/orin_bcap_python_samples others/Get_Syslog.py.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from typing import TextIO

from bcapscope.client.objects import Robot
from bcapscope.protocol.variant import Value

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

TITLES = tuple(f"[J{axis} - {what}]" for axis in range(1, 9) for what in _AXES) + tuple(
    f"[{title}]" for title in _REST
)
"""The 39 columns: set point, encoder, current and load of each axis, then what the program adds."""


async def start_log(robot: Robot) -> None:
    """Empty the log and begin to record."""
    await robot.execute("ClearLog")
    await robot.execute("StartLog")


async def read_log(robot: Robot) -> list[Value]:
    """Stop recording and return the records, the oldest first."""
    await robot.execute("StopLog")
    count = await robot.execute("GetLogCount")
    return [
        await robot.execute("GetLogRecord", index) for index in range(count if isinstance(count, int) else 0)
    ]


def write_log(file: TextIO, records: Sequence[Value]) -> None:
    """Write a line a record.

    Raises:
        OSError: there is no room, or the like.
    """
    rows = csv.writer(file, lineterminator="\n")
    rows.writerow(TITLES)
    rows.writerows(record if isinstance(record, tuple) else (record,) for record in records)
