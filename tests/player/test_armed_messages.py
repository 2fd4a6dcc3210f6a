"""The armed calls of a player, in the action log."""

from __future__ import annotations

from pathlib import Path

import orjson
import pytest

from bcapscope.client.action_log import ActionLog, LoggedConnection
from bcapscope.client.armed_calls import ArmedCalls
from bcapscope.player.armed_messages import ArmedMessages
from bcapscope.player.messages import Counts, Ended, Outcome, Packet, Peer, Progress, State
from bcapscope.protocol.frame import encode
from bcapscope.protocol.variant import VT, Variant

TIME = 1_700_000_000_000_000_000


def execute(serial: int, command: str, value: int) -> bytes:
    return encode(serial, 0, 64, (Variant(VT.I4, 1), Variant(VT.BSTR, command), Variant(VT.I4, value)))


@pytest.mark.parametrize("simulator", [False, True])
def test_what_a_player_sends_to_a_robot_is_logged(tmp_path: Path, simulator: bool) -> None:
    log = ActionLog(tmp_path, "play", lambda path, error: None)
    messages = ArmedMessages(ArmedCalls(log, LoggedConnection("192.0.2.1", 5007, "udp")))
    for message in (
        Packet(True, execute(1, "slvGetMode", 0), TIME),
        Peer(simulator, "RC8", {}, 0x202, (), 0.0),
        Packet(True, execute(2, "Motor", 1), TIME),
        Packet(False, encode(2, 0, 0, ()), TIME),
        Progress(State.PLAYING, index=100),
        Packet(True, execute(3, "slvChangeMode", 0), TIME),
        Ended(Outcome.DONE, counts=Counts(sent=250)),
    ):
        messages.add(message)
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
