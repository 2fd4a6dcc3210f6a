"""The controller's own log of a motion, saved as CSV.

What a record of GetLogRecord holds, its order and the titles of the columns are those of
ShoheiKobata/orin_bcap_python_samples others/Get_Syslog.py.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from typing import BinaryIO

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.client.object_opener import ObjectOpener
from bcapscope.client.remote_objects import Robot
from bcapscope.client.retry_policies import DEFAULT_RETRY_POLICIES
from bcapscope.client.session import Session
from bcapscope.player.blocking_caller import BlockingCaller, run_blocking
from bcapscope.player.channel import open_channel
from bcapscope.protocol.codec.variant import Value
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
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
"""The 39 columns: set point, encoder, current and load of each axis, then what the program adds."""


async def read_log_records(
    session: Session, target: ControllerTarget, robot_name: str, check_abort: Callable[[], None]
) -> list[Value]:
    """Read them by a session in which nothing is open yet; what `check_abort` raises ends it between two
    records.

    Raises:
        BcapError: as `Session.call`.
    """
    records: list[Value] = []
    try:
        reach = ObjectOpener(session, target.service, target.connect, {ObjectClass.ROBOT: robot_name})
        robot = Robot(session, await reach.handle_for(ObjectClass.ROBOT))
        count = await robot.execute("GetLogCount")
        for index in range(count if isinstance(count, int) else 0):
            check_abort()
            records.append(await robot.execute("GetLogRecord", index))
        return records
    finally:
        await session.close()


def read_control_log(target: ControllerTarget, robot: str, check_abort: Callable[[], None]) -> list[Value]:
    """Read the records that the controller holds, the oldest first; what `check_abort` raises ends that.

    By a connection of its own, over TCP: a record has 39 values, too many for the 503 bytes of a datagram.

    Raises:
        BcapError: as `Session.call`.
        OSError: there is no way to the controller.
    """
    channel = open_channel(target.host, target.port, tcp=True)
    tcp = (ReservedConvention.TCP0, ReservedConvention.TCP1)
    convention = target.convention if target.convention in tcp else ReservedConvention.TCP0
    session = Session(BlockingCaller(channel, convention), DEFAULT_RETRY_POLICIES)
    return run_blocking(read_log_records(session, target, robot, check_abort))


def _csv_cell(value: object) -> object:
    """Keep a spreadsheet from computing a text, with an apostrophe before it; numbers stay as they are."""
    return f"'{value}" if isinstance(value, str) and is_spreadsheet_formula(value) else value


def write_control_log(file: BinaryIO, records: Sequence[Value]) -> None:
    """Write a line a record, in UTF-8.

    Raises:
        OSError: there is no room, or the like.
    """
    text = io.StringIO(newline="")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(LOG_COLUMN_TITLES)
    rows.writerows(map(_csv_cell, record if isinstance(record, tuple) else (record,)) for record in records)
    file.write(text.getvalue().encode(errors="backslashreplace"))
    file.flush()
