"""The armed calls of a player, in the action log."""

from __future__ import annotations

from pathlib import Path

import orjson
import pytest

from bcapscope.client.action_log import ActionLog, ArmedCallLogger, LoggedConnection
from bcapscope.player.player_messages import (
    ControllerInfo,
    FrameMessage,
    PlayCounts,
    PlayEnded,
    PlayOutcome,
    PlayProgress,
    PlayState,
)
from bcapscope.player.player_process import ArmedMessageLogger
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant

TIME = 1_700_000_000_000_000_000


def execute(serial: int, command: str, value: int) -> bytes:
    return encode_frame(serial, 0, 64, (Variant(VT.I4, 1), Variant(VT.BSTR, command), Variant(VT.I4, value)))


@pytest.mark.parametrize("simulator", [False, True])
def test_what_a_player_sends_to_a_robot_is_logged(tmp_path: Path, simulator: bool) -> None:
    log = ActionLog(tmp_path, "play", lambda path, error: None)
    messages = ArmedMessageLogger(ArmedCallLogger(log, LoggedConnection("192.0.2.1", 5007, "udp")))
    for message in (
        FrameMessage(True, execute(1, "slvGetMode", 0), TIME),
        ControllerInfo(simulator, "RC8", {}, 0x202, (), 0.0),
        FrameMessage(True, execute(2, "Motor", 1), TIME),
        FrameMessage(False, encode_frame(2, 0, 0, ()), TIME),
        PlayProgress(PlayState.PLAYING, index=100),
        FrameMessage(True, execute(3, "slvChangeMode", 0), TIME),
        PlayEnded(PlayOutcome.DONE, counts=PlayCounts(sent=250)),
    ):
        messages.on_message(message)
    log.close()
    lines = [orjson.loads(line) for path in tmp_path.iterdir() for line in path.read_bytes().splitlines()]
    found = [(line.get("sent"), line.get("received"), line.get("set_points")) for line in lines]
    if simulator:
        assert found == []
    else:
        assert found == [
            ("Robot_Execute Motor", None, None),
            (None, "S_OK", None),
            ("Robot_Execute slvMove", None, 250),
        ]
