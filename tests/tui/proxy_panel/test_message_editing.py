"""A message and what becomes of it by what is typed."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import ARRAY, VT, Variant
from bcapscope.traffic.observation import (
    SERVER_PARTICIPANT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Transport,
)
from bcapscope.tui.proxy_display import edited_message, proposed_edit

ENDS = Endpoint("10.0.0.2", 50001), Endpoint("10.0.0.1", 5007)
FLOW = Flow(Conversation(*ENDS, Transport.UDP, SERVER_PARTICIPANT), Direction.REQUEST)
HANDLE, COMMAND, MODE = Variant(VT.I4, 2), Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I4, 258)
MESSAGE = encode_frame(9, 0, 64, [HANDLE, COMMAND, MODE])


@pytest.mark.parametrize(
    ("text", "made"),
    [
        ("set arg[2]=0", encode_frame(9, 0, 64, [HANDLE, COMMAND, Variant(VT.I4, 0)])),
        ("set arg[2]=i2:0", encode_frame(9, 0, 64, [HANDLE, COMMAND, Variant(VT.I2, 0)])),
        (
            'set arg[1]="a b" serial 10',
            encode_frame(10, 0, 64, [HANDLE, Variant(VT.BSTR, "a b"), MODE]),
        ),
        ("01 02\tff", b"\x01\x02\xff"),
    ],
)
def test_what_is_typed_is_done(text: str, made: bytes) -> None:
    assert edited_message(MESSAGE, FLOW, text) == made


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "expected: set"),
        ("0", "two hex digits"),
        ("set arg[7]=1", "changes nothing"),
        ("set arg[2]=258", "changes nothing"),
        ("set arg[2]=many", "changes nothing"),
        ("set arg[2]", "expected an argument"),
        ("drop", "is not allowed here"),
        ("limit arg[x]=1..2", "is not an argument"),
        ("[/foo]\x1b[31m", "is not allowed here"),
    ],
)
def test_what_makes_no_sense_is_told(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason) as raised:
        edited_message(MESSAGE, FLOW, text)
    assert "\x1b" not in str(raised.value)


@pytest.mark.parametrize(
    ("values", "offset", "text"),
    [
        ([HANDLE, COMMAND, MODE], 0, "set arg[2]=258"),
        ([HANDLE, COMMAND, MODE], 16, "set arg[0]=2"),
        ([HANDLE, COMMAND, MODE], 40, "set arg[1]=slvChangeMode"),
        ([Variant(VT.BSTR, 'a "b" 日本')], 0, 'set arg[0]="a \\"b\\" 日本"'),
        ([Variant(VT.R4 | ARRAY, (1.0, 2.5), 2)], 0, "set arg[0]=1.0,2.5"),
        ([], 0, ""),
    ],
)
def test_what_is_proposed_can_be_typed_and_leaves_all_as_it_is(
    values: list[Variant], offset: int, text: str
) -> None:
    message = encode_frame(1, 0, 64, values)
    assert proposed_edit(message, offset) == text
    if text:
        with pytest.raises(ValueError, match="changes nothing"):
            edited_message(message, FLOW, text)


def test_of_damaged_messages_nothing_is_proposed_but_their_bytes_can_be_changed() -> None:
    assert proposed_edit(MESSAGE[:20], 0) == ""
    assert proposed_edit(b"", 0) == ""
    assert edited_message(MESSAGE[:20], FLOW, MESSAGE.hex(" ")) == MESSAGE
    assert Frame(edited_message(MESSAGE, FLOW, "serial 77")).serial == 77
