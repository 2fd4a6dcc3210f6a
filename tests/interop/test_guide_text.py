"""The 2009 guide as text, prose and dumps together: every dump is found and what is wrong with it is said."""

from __future__ import annotations

import json
from typing import NamedTuple

import pytest

from bcapscope.capture.hex_text import HexPacket
from bcapscope.protocol.dissection.frame_repair import find_repair
from bcapscope.protocol.dissection.repair_text import damage_problem
from bcapscope.traffic.observation import Direction
from tests.dumps import packets_in
from tests.samples.guide import DUMPS
from tests.shared_folder import SHARED

pytestmark = pytest.mark.interop

GUIDE, VECTORS = SHARED / "SEED.txt", SHARED / "vectors.json"

if not (GUIDE.exists() and VECTORS.exists()):
    pytest.skip(f"{GUIDE} or {VECTORS} is missing: the text of the guide", allow_module_level=True)

PACKETS = {packet.line: packet for packet in packets_in(GUIDE.read_text())}
SOUND = {vector["name"]: bytes.fromhex(vector["hex"]) for vector in json.loads(VECTORS.read_text())}
REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE


class Expected(NamedTuple):
    """A dump of the guide: line, bytes, sender, vector of what it was, and words of what is said."""

    line: int
    size: int
    direction: Direction | None
    vector: str | None
    words: tuple[str, ...]


TWO = (
    "2 zero bytes lost: at offset 12 in the function id (3 of 4 bytes there), "
    "at offset 27 in the value of hRobot (3 of 4 bytes there)",
)
TWO_REPLY = (
    "2 zero bytes lost: at offset 12 in the HRESULT (3 of 4 bytes there), "
    "at offset 55 in the value of pVal (31 of 32 bytes there); it then reads S_OK, VT_R4|VT_ARRAY",
)
CUT = ("cut after 51 of 100 bytes, in the characters of bstrCommand", *TWO, "47 bytes missing", "slvMo")

FRAMES = (
    Expected(385, 82, REQUEST, "seed_slvChangeMode_tx", ()),
    Expected(
        395,
        15,
        RESPONSE,
        "seed_slvChangeMode_rx",
        ("1 zero byte lost: at offset 14 in the argument count (1 of 2 bytes there)", "S_OK"),
    ),
    Expected(
        407,
        79,
        REQUEST,
        "seed_slvGetMode_tx",
        ("1 zero byte too many: at offset 77 in the string length of vntParam (5 bytes for 4)",),
    ),
    Expected(416, 28, RESPONSE, "seed_slvGetMode_rx", ()),
    Expected(431, 96, REQUEST, "seed_slvMove_P_tx", ()),
    Expected(500, 98, REQUEST, "seed_udp_normal_tx", TWO),
    Expected(511, 56, RESPONSE, "seed_udp_normal_rx", TWO_REPLY),
    Expected(520, 51, REQUEST, "seed_udp_retry_first_tx", CUT),
    Expected(528, 51, REQUEST, "seed_udp_retry1_tx", CUT),
    Expected(536, 51, REQUEST, "seed_udp_retry2_tx", CUT),
    Expected(544, 98, REQUEST, "seed_udp_retry3_tx", TWO),
    Expected(555, 56, RESPONSE, "seed_udp_retry_rx1", TWO_REPLY),
    Expected(564, 56, RESPONSE, "seed_udp_retry_rx2", TWO_REPLY),
    Expected(
        637,
        84,
        REQUEST,
        "seed_tester_slvChangeMode_tx",
        ("8E for 6E at offset 55 and 85 for 65 at offset 59", "slvChangeMode"),
    ),
    Expected(644, 16, RESPONSE, "seed_tester_slvChangeMode_rx", ()),
    Expected(655, 92, REQUEST, "seed_tester_slvMove_tx", ("85 for 65 at offset 55", "slvMove")),
)
CELLS = (
    Expected(389, 14, None, None, ("VT_I4 1: its last byte, 0A, belongs in front",)),
    Expected(391, 41, None, None, ("VT_BSTR slvChangeMode: a zero byte too many, at offset 40",)),
    Expected(393, 12, None, None, ("no frame, but an argument of a frame, VT_I2 2",)),
    Expected(410, 14, None, None, ("no frame, but an argument of a frame, VT_I4 1",)),
    Expected(412, 32, None, None, ("no frame, but an argument of a frame, VT_BSTR SLAVEMODE",)),
    Expected(414, 15, None, None, ("VT_BSTR '': a zero byte too many, at offset 14",)),
    Expected(419, 12, None, None, ("no frame, but an argument of a frame, VT_I2 2",)),
    Expected(439, 28, None, None, ("no frame, but an argument of a frame, VT_BSTR SLVMOVE",)),
    Expected(450, 38, None, None, ("no frame, but an argument of a frame, VT_R4|VT_ARRAY of 7 elements",)),
)
EXPECTED = sorted((*FRAMES, *CELLS))


def request_side(packet: HexPacket) -> bool | None:
    return None if packet.direction is None else packet.direction is REQUEST


def test_nothing_but_the_dumps_is_found() -> None:
    found = [(packet.line, len(packet.data)) for packet in packets_in(GUIDE.read_text())]
    assert found == [*((expected.line, expected.size) for expected in EXPECTED), (655, 58)]


@pytest.mark.parametrize("expected", [e for e in EXPECTED if e.line != 655], ids=lambda e: str(e.line))
def test_what_is_said_of_it(expected: Expected) -> None:
    packet = PACKETS[expected.line]
    assert (packet.direction, packet.is_direction_guessed) == (expected.direction, False)
    told = damage_problem(packet.data, request_side(packet))
    assert (told is None) is (not expected.words)
    for words in expected.words:
        assert told is not None
        assert words in str(told.reason)


@pytest.mark.parametrize("expected", [e for e in FRAMES if e.line != 655], ids=lambda e: str(e.line))
def test_repaired_it_is_the_frame_that_it_was(expected: Expected) -> None:
    packet = PACKETS[expected.line]
    mended = find_repair(packet.data, request_side(packet))
    assert expected.vector is not None
    sound = SOUND[expected.vector]
    assert (mended.raw if mended else packet.data) == sound[
        : len(sound) - (mended.missing_at_end if mended else 0)
    ]


def test_the_last_page_with_both_dumps_in_one_line() -> None:
    request, reply = (packet for packet in packets_in(GUIDE.read_text()) if packet.line == 655)
    mended = find_repair(request.data, True)
    assert mended is not None
    assert mended.raw == SOUND["seed_tester_slvMove_tx"]
    assert reply.data == SOUND["seed_tester_slvMove_rx"]
    assert (request.direction, reply.direction) == (REQUEST, RESPONSE)


def test_the_reply_with_a_serial_of_its_own_is_told() -> None:
    notes = {line: packet.notes for line, packet in PACKETS.items() if packet.notes}
    assert notes == {395: ("serial 8, the request above has 5: they do not belong together",)}


def test_the_samples_hold_what_the_guide_prints() -> None:
    frames = [packet.data for packet in packets_in(GUIDE.read_text()) if packet.data[:1] == b"\x01"]
    assert frames == [bytes.fromhex(dump.printed) for dump in DUMPS]
    assert {dump.frame for dump in DUMPS} <= set(SOUND.values())
