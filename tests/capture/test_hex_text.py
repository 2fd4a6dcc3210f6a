"""Packets out of pasted text."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.capture import hex_block
from bcapscope.capture.hex_block import LARGEST_BLOCK
from bcapscope.capture.hex_text import MAX_REPEATED, HexPacket
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.traffic.observation import Direction
from tests.damaged import CHANGE_MODE, DONE, GET_MODE, MOVE, MOVED, NUMBER, SOUND, TEXT, without
from tests.dumps import (
    FORMS,
    characters,
    hexdump,
    one_line,
    packets_in,
    rows,
    window,
    wireshark_bare_dump,
    wireshark_dump,
    xxd,
)
from tests.samples.wire import Host, ethernet, tcp, udp
from tests.strategies import frames

Form = Callable[[bytes], str]
REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
MUTE = encode_frame(7, 0, 0x7FFFFFFF)
"""Neither a function nor a result."""

ZEROS = encode_frame(7, 0, 0, (Variant.array(VT.R8, (0.0,) * 20),))


def notes_of(packet: HexPacket) -> tuple[str, ...]:
    return tuple(map(str, packet.notes))


def found(text: str) -> list[bytes]:
    return [packet.data for packet in packets_in(text)]


def only(text: str) -> HexPacket:
    (packet,) = packets_in(text)
    return packet


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("frame", [*SOUND, ZEROS])
def test_forms(form: Form, frame: bytes) -> None:
    assert found(form(frame)) == [frame]


@pytest.mark.parametrize("form", FORMS)
def test_two_frames_in_one_dump(form: Form) -> None:
    assert found(form(MOVE + MOVED)) == [MOVE, MOVED]


@pytest.mark.parametrize("form", FORMS)
def test_damaged_frames_come_out_as_they_are(form: Form) -> None:
    raw = without(MOVE, 12, 28)
    assert found(form(raw)) == [raw]


@given(frames().filter(lambda frame: len(frame) < 60_000), st.sampled_from(FORMS))
def test_any_frame_in_any_form(frame: bytes, form: Form) -> None:
    assert found("TX:\n" + form(frame)) == [frame]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("quote", ["> ", ">> ", "    ", "\t"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_quoted_mail(form: Form, quote: str, end: str) -> None:
    text = end.join(quote + line for line in form(CHANGE_MODE).split("\n"))
    assert found(f"> On Tuesday somebody wrote:{end}{text}{end}> Regards") == [CHANGE_MODE]


@pytest.mark.parametrize("form", FORMS)
def test_captions_give_direction_and_line(form: Form) -> None:
    text = f"We saw this.\n\nTX\n{form(MOVE)}\n\nRX\n{form(MOVED)}\n"
    first, second = packets_in(text)
    assert (first.direction, first.is_direction_guessed, first.data) == (REQUEST, False, MOVE)
    assert (second.direction, second.is_direction_guessed, second.data) == (RESPONSE, False, MOVED)
    lines = text.splitlines()
    for packet, word in ((first, "TX"), (second, "RX")):
        assert word in lines[packet.line - 2 : packet.line] or word in lines[packet.line - 3]


@pytest.mark.parametrize(
    ("caption", "direction"),
    [("- SendData (in red):", REQUEST), ("Server \u21d2 PC", RESPONSE), ("TX/RX", None), ("Figure 3", None)],
)
def test_captions(caption: str, direction: Direction | None) -> None:
    packet = only(f"{caption}\n{window(MUTE)}")
    assert packet == HexPacket(MUTE, direction, False, caption.strip("- :"), 2, ())


def test_a_caption_on_the_same_line() -> None:
    packet = only(f"12:01:33.5 RX <pre> {one_line(DONE)} </pre>")
    assert (packet.data, packet.direction, packet.caption, packet.line) == (
        DONE,
        RESPONSE,
        "12:01:33.5 RX",
        1,
    )


def test_of_two_captions_the_one_that_tells_more() -> None:
    text = f"Packet\tTX(Client->Server):\t\nTX\t{one_line(DONE)}"
    assert only(text).caption == "Packet TX(Client->Server)"


def test_of_a_paragraph_the_last_sentence() -> None:
    words = "The window shows 'SendData' and 'ReceiveData'. " + "It is big. " * 20
    send = f"The 'SendData' block holds: {one_line(CHANGE_MODE)}. "
    receive = f"The 'ReceiveData' block holds: {one_line(DONE)}."
    first, second = packets_in(words + send + receive)
    assert (first.data, first.direction, first.caption) == (
        CHANGE_MODE,
        REQUEST,
        "The 'SendData' block holds",
    )
    assert (second.data, second.direction) == (DONE, RESPONSE)


@pytest.mark.parametrize(("frame", "direction"), [(MOVE, REQUEST), (MOVED, RESPONSE), (CHANGE_MODE, REQUEST)])
def test_without_a_caption_the_bytes_tell_and_that_is_a_guess(frame: bytes, direction: Direction) -> None:
    packet = only(window(frame))
    assert (packet.direction, packet.is_direction_guessed, packet.caption) == (direction, True, "")
    damaged = only(window(without(frame, 17)))
    assert (damaged.direction, damaged.is_direction_guessed) == (direction, True)


def test_bytes_that_tell_nothing() -> None:
    packet = only(window(MUTE))
    assert (packet.direction, packet.is_direction_guessed) == (None, False)


def test_a_caption_that_the_bytes_contradict() -> None:
    packet = only("TX\n" + window(DONE))
    assert packet.direction is REQUEST
    assert notes_of(packet) == ("captioned as a request, but the bytes are a response",)


def test_a_serial_that_no_request_has() -> None:
    other = encode_frame(8, 0, 0)
    notes = [notes_of(packet) for packet in packets_in("\n\n".join(map(window, (CHANGE_MODE, other, DONE))))]
    assert notes == [(), ("serial 8 does not match the request above, which has serial 5",), ()]


def test_replies_to_earlier_tries_are_no_mismatch() -> None:
    tries = [encode_frame(serial, 1232, 2) for serial in (1232, 1233, 1234)]
    text = "\n\n".join(map(window, [*tries, encode_frame(1233, 1232, 0)]))
    assert [notes_of(packet) for packet in packets_in(text)] == [()] * 4


def test_blank_lines_do_not_cut_a_frame() -> None:
    lines = window(MOVE).split("\n")
    assert found("\n\n".join(lines)) == [MOVE]


def test_the_number_of_a_page_does_not_get_into_a_frame() -> None:
    lines = window(MOVE).split("\n")
    assert found("\n".join([*lines[:3], "", "12", "", *lines[3:]])) == [MOVE]


def test_blank_lines_separate_whole_frames() -> None:
    first, second = packets_in(f"TX\n{window(CHANGE_MODE)}\n\n{window(DONE)}")
    assert (first.direction, first.is_direction_guessed) == (REQUEST, False)
    assert (second.direction, second.is_direction_guessed) == (RESPONSE, True)


def test_what_has_a_caption_of_its_own_is_not_joined() -> None:
    assert found(f"TX\n{window(MOVE[:51])}\nRetry #1\n{window(MOVE[51:])}") == [MOVE[:51], MOVE[51:]]


def test_a_damaged_frame_ends_where_a_row_begins_the_next() -> None:
    damaged = without(MOVE, 12)
    assert found(f"{window(damaged)}\n{window(DONE)}\n{window(GET_MODE)}") == [damaged, DONE, GET_MODE]


@pytest.mark.parametrize("form", [wireshark_dump, wireshark_bare_dump, hexdump, xxd])
def test_offsets_that_begin_anew(form: Form) -> None:
    half = without(MOVE, 12, 28)[:51]
    assert found(f"{form(half)}\n{form(MOVE)}") == [half, MOVE]


def test_characters_wrapped_by_a_mailer() -> None:
    wrapped = "\n".join(
        part for line in wireshark_dump(MOVE).split("\n") for part in (line[:54].rstrip(), line[54:])
    )
    assert found(wrapped) == [MOVE]


def test_offsets_tell_rows_that_are_missing() -> None:
    lines = wireshark_dump(MOVE).split("\n")
    packet = only("\n".join([*lines[:2], *lines[3:]]))
    assert packet.data == MOVE[:32] + MOVE[48:]
    assert notes_of(packet) == ("16 bytes missing in the text before line 3",)


@pytest.mark.parametrize("width", [4, 8, 10, 12, 20, 32, 64])
def test_rows_of_any_width(width: int) -> None:
    lines = [f"{start:04x}: {row.hex(' ')}  {characters(row)}" for start, row in rows(MOVE, width)]
    assert found("\n".join(lines)) == [MOVE]


def test_follow_stream_with_the_server_indented() -> None:
    client = hexdump(CHANGE_MODE).split("\n")[:-1]
    server = ["    " + line for line in hexdump(DONE).split("\n")[:-1]]
    assert found("\n".join(client + server)) == [CHANGE_MODE, DONE]


def test_half_a_byte_at_the_end() -> None:
    packet = only(DONE.hex()[:-1])
    assert packet.data == DONE[:-1]
    assert notes_of(packet) == ("the text ends in the middle of a byte",)


def test_a_long_row_wrapped_in_the_middle_of_a_byte() -> None:
    row = MOVE.hex()
    assert found(row[:75] + "\n" + row[75:150] + "\n" + row[150:]) == [MOVE]


CLIENT = Host(bytes.fromhex("020000000001"), "10.0.0.2", 50001)
SERVER = Host(bytes.fromhex("020000000002"), "10.0.0.1", 5007)
ENDS6 = (CLIENT._replace(ip="fd00::2"), SERVER._replace(ip="fd00::1"))


@pytest.mark.parametrize(
    ("packet", "data", "direction", "skipped"),
    [
        (ethernet(CLIENT, SERVER, udp(CLIENT, SERVER, DONE)), DONE, REQUEST, 42),
        (ethernet(SERVER, CLIENT, udp(SERVER, CLIENT, DONE)), DONE, RESPONSE, 42),
        (ethernet(*ENDS6, udp(*ENDS6, MOVE), (42,)), MOVE, REQUEST, 66),
        (udp(CLIENT, SERVER, MOVE), MOVE, REQUEST, 28),
        (
            ethernet(SERVER, CLIENT, tcp(SERVER, CLIENT, seq=1, ack=1, flags=24, payload=MOVED)),
            MOVED,
            RESPONSE,
            54,
        ),
        (udp(CLIENT, SERVER._replace(port=9), MOVE), MOVE, None, 28),
    ],
)
def test_whole_packets_of_a_network_card(
    packet: bytes, data: bytes, direction: Direction | None, skipped: int
) -> None:
    read = only(wireshark_dump(packet))
    assert read.data == data
    assert read.direction is (direction or REQUEST)
    assert read.is_direction_guessed is (direction is None)
    assert notes_of(read) == (f"removed {skipped} bytes of network headers",)


@pytest.mark.parametrize(
    "part",
    [
        udp(CLIENT, SERVER._replace(port=5008), MOVE)[:-5],
        udp(CLIENT, SERVER._replace(port=5008), MOVE[:-5]),
        tcp(CLIENT, SERVER._replace(port=5008), seq=1, ack=1, flags=24, payload=MOVE[:-5]),
        tcp(CLIENT, SERVER, seq=1, ack=1, flags=4, payload=MOVE[:-5]),
    ],
)
def test_a_part_of_a_frame_in_a_packet_of_any_ports(part: bytes) -> None:
    assert found(wireshark_dump(ethernet(CLIENT, SERVER, part))) == [MOVE[:-5]]


def test_packets_of_other_protocols_stay_as_they_are() -> None:
    other = ethernet(CLIENT, SERVER, udp(CLIENT, SERVER, b"\x1c" + bytes(47)))
    assert found(wireshark_dump(other)) == [other]
    assert found(wireshark_dump(udp(CLIENT, SERVER, b""))) == [udp(CLIENT, SERVER, b"")]


@pytest.mark.parametrize("data", [NUMBER, TEXT, TEXT + b"\0"])
def test_arguments_in_a_table(data: bytes) -> None:
    packet = only(f"hRobot\tThe handle of robot\tVT_I4\n\tBinary\n\t{window(data)}\nvntParam")
    assert (packet.data, packet.direction, packet.caption) == (data, None, "Binary")


def test_bytes_that_slipped_into_the_cell_before() -> None:
    text = f"bstrCommand\tCommand\t\u201cslvChangeMode\u201d {one_line(TEXT[:3])}\n\t{one_line(TEXT[3:])}"
    packet = only(text)
    assert (packet.data, packet.line) == (TEXT, 1)


def test_a_number_before_a_frame_does_not_get_into_it() -> None:
    assert found(f"the answer is 10\n{window(DONE)}") == [DONE]


def test_words_behind_the_last_bytes() -> None:
    rows = window(MOVE).split("\n")
    assert found("\n".join([*rows[:-1], rows[-1] + " <- EOT"])) == [MOVE]
    assert found("\n".join([*rows, "04 is the end of it"])) == [MOVE]


PROSE = """
Add the Face DEAD of the Cafe, be a Bad Dad: 0x101 and 600B, @E, 8msec, 0x0000001.
DEAD
The serial number is "D0 04", reserved is "00 00". Mode 0x001 - 0x003, or 0x202.
20 30
12.42261, 60.36108, 17.63232, 35.81433
10 20 30 40 50 60 70 80 90
2023-11-14 22:13:20 10.6.235.60 02:00:c0:a8:00:0a 12-34-56
commit 2c26b46b68ffc68ff99b453c1d30413413422d70
1) Set the option 1214.

*
0000
;;; ... --- >>>
"""


def test_prose_is_left_alone() -> None:
    assert packets_in(PROSE) == []


@pytest.mark.parametrize("form", FORMS)
def test_prose_around_hex_changes_nothing(form: Form) -> None:
    assert found(f"{PROSE}\n\n{form(MOVE)}\n{PROSE}") == [MOVE]


def test_hex_that_is_no_frame_is_not_dropped() -> None:
    assert found("de ad be ef 12 34 56 78 9a") == [bytes.fromhex("deadbeef123456789a")]


TEXTS = st.lists(
    st.text(max_size=30)
    | st.sampled_from(
        [
            "TX",
            "RX:",
            "*",
            "\n",
            "\n\n",
            " ",
            "0000  ",
            "0010: ",
            "00000020",
            "\\x01",
            '"\\x01\\x0',
            "0x",
            "|",
            "> ",
        ]
    )
    | st.binary(max_size=20).map(one_line)
    | st.sampled_from(SOUND).flatmap(lambda frame: st.sampled_from(FORMS).map(lambda form: form(frame)))
)


@given(TEXTS.map("".join) | st.text())
def test_any_text_is_read(text: str) -> None:
    lines = text.count("\n") + text.count("\r") + 1
    for packet in packets_in(text):
        assert packet.data
        assert 1 <= packet.line <= lines
        assert packet.direction is not None or not packet.is_direction_guessed


@pytest.mark.parametrize(
    "text",
    [
        "01 " * 100_000,
        "01  " * 100_000,
        "00 a " * 50_000,
        "01\n" * 50_000,
        "01\n\n" * 20_000,
        "01 10 00 00 00\n\n" * 20_000,
        "\\x01" * 50_000,
        "'\\x01" * 20_000,
        "\\ " * 50_000,
        "<a" * 50_000,
        "client  " * 50_000,
        "0000 01 52\n*\n" * 10_000,
        "0000 01 52\n*\n10000\n" * 20,
        "a" * 200_000,
        "f" * 200_001,
    ],
    ids=range(15),
)
def test_long_texts_take_no_longer_than_they_are(text: str) -> None:
    """Each would take minutes if the work grew with the square of the length."""
    packets_in(text)


def test_asterisks_do_not_make_much_of_a_short_text() -> None:
    rows = [f"{60_000 * row:08x}  00 00 00 00\n*" for row in range(200)]
    assert len(rows) * 60_000 > 10 * MAX_REPEATED
    packets = packets_in("\n".join(rows))
    assert sum(len(packet.data) for packet in packets) <= MAX_REPEATED + 4 * len(rows)


FRAME = encode_frame(
    1, 0, 64, [Variant(VT.I4, 1), Variant(VT.BSTR, "slvMove"), Variant.array(VT.R8, (0.5,) * 8)]
)
MANY = 200


@pytest.mark.parametrize("form", FORMS)
def test_frames_of_a_long_dump_are_whole_wherever_it_is_split(
    form: Callable[[bytes], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hex_block, "LARGEST_BLOCK", 8 * 1024)
    packets = packets_in(form(FRAME * MANY))
    assert {packet.data for packet in packets} == {FRAME}
    assert len(packets) == MANY
    assert [packet.line for packet in packets] == sorted(packet.line for packet in packets)
    assert not any(packet.notes for packet in packets)


_MEASURE = """
import sys, tracemalloc
from itertools import repeat
from bcapscope.capture import hex_block
from bcapscope.capture.hex_text import read_hex_text

hex_block.LARGEST_BLOCK, hex_block.MAX_ROWS = 8 * 1024, 512
for repeats in (3_000, 3_000, 9_000):
    tracemalloc.start()
    for _ in read_hex_text(repeat(sys.argv[1], repeats)):
        pass
    print(tracemalloc.get_traced_memory()[1])
    tracemalloc.stop()
"""


@pytest.mark.parametrize(
    "line", ["01 02 03 00 00 00 00 00", "00", "0" * 2_000, "0000: 01", "TX 01 00", "a b ", ""]
)
def test_lines_without_end_are_read_in_bounded_memory(line: str) -> None:
    """Nothing that is kept grows with the number of lines. A process of its own has no other allocations."""
    measured = subprocess.run(
        [sys.executable, "-c", _MEASURE, line], capture_output=True, text=True, check=True
    )
    _, shorter, longer = map(int, measured.stdout.split())
    assert longer < 1.2 * shorter + 50_000


def test_bytes_of_a_dump_that_are_no_frames_are_cut_and_said_to_be() -> None:
    lines = [f"{place:08x}: " + "00 " * 16 for place in range(0, 2 * LARGEST_BLOCK, 16)]
    first, *others = packets_in("\n".join(lines))
    assert not first.notes
    assert len(first.data) + sum(len(packet.data) for packet in others) == 2 * LARGEST_BLOCK
    assert all("which are too many for one packet" in notes_of(packet)[0] for packet in others)
