"""The 2009 guide as text, prose and dumps together: every dump is found, and shown with its problems."""

from __future__ import annotations

import json
from typing import NamedTuple

import pytest

from bcapscope.capture.pasted_text import PastedText
from bcapscope.traffic.observation import Direction
from tests.dumps import lines_of, packets_in
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
    """A dump of the guide: line, number of bytes, direction, and the codes of its problems."""

    line: int
    size: int
    direction: Direction | None
    problems: str


EXPECTED = (
    Expected(385, 82, REQUEST, ""),
    Expected(389, 14, None, "soh"),
    Expected(391, 41, None, "soh"),
    Expected(393, 12, None, "soh argument"),
    Expected(395, 15, RESPONSE, "length argc eot"),
    Expected(407, 79, REQUEST, "length left-over"),
    Expected(410, 14, None, "soh argument"),
    Expected(412, 32, None, "soh argument"),
    Expected(414, 15, None, "soh"),
    Expected(416, 28, RESPONSE, ""),
    Expected(419, 12, None, "soh argument"),
    Expected(431, 96, REQUEST, ""),
    Expected(439, 28, None, "soh argument"),
    Expected(450, 38, None, "soh argument"),
    Expected(500, 98, REQUEST, "length type"),
    Expected(511, 56, RESPONSE, "length type"),
    Expected(520, 51, REQUEST, "length type eot"),
    Expected(528, 51, REQUEST, "length type eot"),
    Expected(536, 51, REQUEST, "length type eot"),
    Expected(544, 98, REQUEST, "length type"),
    Expected(555, 56, RESPONSE, "length type"),
    Expected(564, 56, RESPONSE, "length type"),
    Expected(637, 84, REQUEST, "name"),
    Expected(644, 16, RESPONSE, ""),
    Expected(655, 92, REQUEST, "name"),
    Expected(655, 58, RESPONSE, ""),
)


def test_each_dump_is_found_and_shown_with_its_problems() -> None:
    text = GUIDE.read_text()
    packets, pasted = packets_in(text), PastedText(lines_of(text))
    problems = [" ".join(problem.code for problem in seen.item.problems) for seen in pasted]
    found = zip(packets, problems, strict=True)
    assert [Expected(each.line, len(each.data), each.direction, codes) for each, codes in found] == [
        *EXPECTED
    ]
    assert not any(packet.is_direction_guessed for packet in packets)


def test_sound_dumps_are_the_frames_of_the_vectors() -> None:
    sound = {expected.line for expected in EXPECTED if expected.direction and not expected.problems}
    frames = {packet.data for packet in packets_in(GUIDE.read_text()) if packet.line in sound - {655}}
    assert frames <= set(SOUND.values())
    assert len(frames) == 4


def test_the_reply_with_a_serial_of_its_own_is_told() -> None:
    notes = {line: tuple(map(str, packet.notes)) for line, packet in PACKETS.items() if packet.notes}
    assert notes == {395: ("serial 8 does not match the request above, which has serial 5",)}


def test_the_samples_hold_what_the_guide_prints() -> None:
    frames = [packet.data for packet in packets_in(GUIDE.read_text()) if packet.data[:1] == b"\x01"]
    assert frames == [bytes.fromhex(dump.printed) for dump in DUMPS]
    assert {dump.frame for dump in DUMPS} <= set(SOUND.values())
