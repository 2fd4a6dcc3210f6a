"""The controller's own log of a motion, saved as CSV.

What a record of GetLogRecord holds, its order and the titles of the columns are those of
ShoheiKobata/orin_bcap_python_samples others/Get_Syslog.py.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from typing import BinaryIO

from bcapscope.client.objects import Robot
from bcapscope.client.paces import PACES
from bcapscope.client.reach import Reach
from bcapscope.client.session import Session
from bcapscope.client.target import Target
from bcapscope.player.channel import open_channel
from bcapscope.player.exchanger import BlockingExchanger, run
from bcapscope.protocol.convention import Convention
from bcapscope.protocol.functions import ObjectClass
from bcapscope.protocol.variant import Value
from bcapscope.protocol.wording import is_computed

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


async def read_records(
    session: Session, target: Target, robot_name: str, look: Callable[[], None]
) -> list[Value]:
    """Read them by a session in which nothing is open yet; what `look` raises ends it between two records.

    Raises:
        BcapError: as `Session.call`.
    """
    records: list[Value] = []
    try:
        reach = Reach(session, target.service, target.connect, {ObjectClass.ROBOT: robot_name})
        robot = Robot(session, await reach.handle(ObjectClass.ROBOT))
        count = await robot.execute("GetLogCount")
        for index in range(count if isinstance(count, int) else 0):
            look()
            records.append(await robot.execute("GetLogRecord", index))
        return records
    finally:
        await session.close()


def read_log(target: Target, robot: str, look: Callable[[], None]) -> list[Value]:
    """Read the records that the controller holds, the oldest first; what `look` raises ends that.

    By a connection of its own, over TCP: a record has 39 values, too many for the 503 bytes of a datagram.

    Raises:
        BcapError: as `Session.call`.
        OSError: there is no way to the controller.
    """
    channel = open_channel(target.host, target.port, tcp=True)
    tcp = (Convention.TCP0, Convention.TCP1)
    convention = target.convention if target.convention in tcp else Convention.TCP0
    session = Session(BlockingExchanger(channel, convention), PACES)
    return run(read_records(session, target, robot, look))


def _cell(value: object) -> object:
    """Keep a spreadsheet from computing a text, with an apostrophe before it; numbers stay as they are."""
    return f"'{value}" if isinstance(value, str) and is_computed(value) else value


def write_log(file: BinaryIO, records: Sequence[Value]) -> None:
    """Write a line a record, in UTF-8.

    Raises:
        OSError: there is no room, or the like.
    """
    text = io.StringIO(newline="")
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(TITLES)
    rows.writerows(map(_cell, record if isinstance(record, tuple) else (record,)) for record in records)
    file.write(text.getvalue().encode(errors="backslashreplace"))
    file.flush()
