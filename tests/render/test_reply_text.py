"""Answers as lines and objects."""

from __future__ import annotations

import json

from bcapscope.errors import Attempt
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.hresult import E_HANDLE, S_OK
from bcapscope.render.color_palette import Palette
from bcapscope.render.reply_text import reply_line, reply_record
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import (
    SERVER_PORT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    Transport,
)

_REPLY = Frame(encode_frame(2, 0, S_OK, (Variant(VT.I2, 2),)))
_TRIES = (Attempt(1, 0, 0), Attempt(2, 1, 2_000_000))


def test_a_line() -> None:
    line = reply_line("Robot_Execute slvGetMode", 64, _REPLY, 2_345_678, _TRIES)
    assert line == "Robot_Execute slvGetMode S_OK pVal=I2(2)  2.346 ms after 1 retry"
    tries = (*_TRIES, Attempt(3, 1, 4_000_000))
    assert reply_line("x", 64, _REPLY, 1, tries).endswith(" after 2 retries")


def test_a_refusal_has_its_meaning_and_names_are_made_harmless() -> None:
    colors = Palette(name="<n>", bad="<b>", reset="<r>", dim="<d>")
    reply = Frame(encode_frame(1, 0, E_HANDLE))
    line = reply_line("Robot_Execute 100%\x1b", 64, reply, 1000, _TRIES[:1], palette=colors)
    assert line.startswith(r"<n>Robot_Execute 100%\x1b<r> <b>E_HANDLE (")
    assert line.endswith("<r>  <d>0.001 ms<r>")


def test_an_object() -> None:
    ends = Conversation(Endpoint("10.0.0.2", 5), Endpoint("10.0.0.1", 5007), Transport.UDP, SERVER_PORT)
    seen = Observation(4, 1_700_000_000_000_000_001, 0, Flow(ends, Direction.RESPONSE), _REPLY, 0)
    record = json.loads(reply_record(seen, CallKind(64, "slvGetMode"), 2_345_678, _TRIES))
    assert record["function"] == "Robot_Execute"
    assert record["command"] == "slvGetMode"
    assert record["args"] == [{"name": "pVal", "type": "VT_I2", "value": 2}]
    assert (record["took_ms"], record["tries"]) == (2.345678, 2)
