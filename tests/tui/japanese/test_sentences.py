"""What lower layers report is in Japanese on a Japanese screen."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.analysis.statistics.call_statistics import StatisticsBuilder
from bcapscope.capture.capture_file import CaptureFile
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.messages import Language, Message, MessageFormatter
from bcapscope.messages.places import Count
from bcapscope.player.preflight import run_preflight
from bcapscope.player.resampling import resample
from bcapscope.player.trajectory import TrajectoryError
from bcapscope.player.trajectory_reader import read_trajectories
from bcapscope.protocol.codec.frame import encode_frame, parse_datagram
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables import enumerations
from bcapscope.protocol.tables.table_text import table_message
from bcapscope.render.escape import printable
from bcapscope.render.frame_tree import field_rows, frame_sections
from bcapscope.render.preflight_text import PreflightRenderer, source_lines
from bcapscope.render.slave_session_text import slave_session_lines
from bcapscope.render.statistics_text import statistics_lines
from bcapscope.traffic.pipeline import Pipeline
from bcapscope.tui.controller_access.saved_requests import SavedRequestError, load_request
from bcapscope.tui.reader_language import reader_words
from tests.analysis.plays import SCENES
from tests.analysis.scenes import Story
from tests.cli.run import CAPTURES
from tests.render.scenes import ROBOT, observe
from tests.tui.japanese.english import left_over

WORDS = MessageFormatter(Language.JAPANESE)

pytestmark = pytest.mark.usefixtures("japanese_screen")

JAPANESE = re.compile("[ぁ-んァ-ヶ一-龥]")


def _is_whole(text: str) -> bool:
    return bool(JAPANESE.search(text)) and not left_over(text)


JAPANESE_WORDS = MessageFormatter(Language.JAPANESE)


def _figures(capture: bytes) -> Iterator[str]:
    """Yield the lines about stays and statistics."""
    stays: list[SlaveSession] = []
    diagnosis, summary = Diagnosis(on_slave_session=stays.append), StatisticsBuilder()
    observations = PacketDecoder(frozenset({5007})).decode(CaptureFile(io.BytesIO(capture)))
    pipeline = Pipeline(diagnosis, summary)
    for observation in observations:
        pipeline.add(observation)
    statistics = summary.statistics()
    pipeline.finish()
    stays += diagnosis.remaining_sessions()
    yield from (line for stay in stays for line in slave_session_lines(stay, words=reader_words()))
    if statistics is not None:
        yield from statistics_lines(statistics, words=JAPANESE_WORDS)


def test_timing_and_statistics_have_no_english_line() -> None:
    captures = []
    for scene in SCENES:
        story = Story()
        scene.fires(story)
        captures.append(story.capture())
    captures.append((CAPTURES / "slave-session.pcapng").read_bytes())
    for capture in captures:
        text = " ".join(" ".join(_figures(capture)).split())
        assert not left_over(re.sub(r"このモードでの推奨 \(.*?\)", "", text)), text  # sources stay


FILES = {
    "empty.csv": b"",
    "sheet.csv": b"PK\x03\x04" + bytes(20),
    "old.csv": b"\xd0\xcf\x11\xe0" + bytes(20),
    "binary.csv": b"1,2\0",
    "latin.csv": b"J1,J2,J3,J4,J5,J6\n\x81\n",
    "titles.csv": b"a,b\n1,2\n",
    "word.csv": b"J1,J2,J3,J4,J5,J6\n1,2,3,4,5,x\n",
    "wide.csv": b"J1,J2,J3,J4,J5,J6\n1,2,3,4,5,6\n1,2,3\n",
    "gone.csv": b"J1,J2,J3,J4,J5,J6\n1,2,3,4,5,6\n1,2,3,4,5,\n",
    "none.csv": b"J1,J2,J3,J4,J5,J6\n",
    "few.csv": b"1 2 3\n",
    "time.csv": b"0 1 2 3 4 5 6\n1 1 2 3 4 5 6\n2 1 2 3 4 5 6\n",
    "odd.json": b"{1",
    "other.json": b'{"a": 1}',
    "ros.json": json.dumps({"joint_names": ["a"], "points": [{}]}).encode(),
    "deep.yaml": b"[" * 200,
    "alias.yaml": b"a: *b\n",
    "cut.pcap": b"\xd4\xc3\xb2\xa1",
    "no.pcapng": b"\x0a\x0d\x0d\x0a" + bytes(30),
}


@pytest.mark.parametrize("name", FILES)
def test_why_a_file_is_no_trajectory(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(FILES[name])
    with pytest.raises(TrajectoryError) as raised:
        read_trajectories(tmp_path / name)
    assert JAPANESE.search(WORDS.text(raised.value.message)), str(raised.value)


def test_why_there_is_no_file_or_project(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("a")
    for path in (tmp_path, tmp_path / "none.csv", "\0"):
        with pytest.raises(TrajectoryError) as raised:
            read_trajectories(path)
        assert JAPANESE.search(WORDS.text(raised.value.message)), str(raised.value)


@pytest.mark.parametrize(
    "content",
    [
        b"1 2 3 4 5 6\n2 3 4 5 6 7\n",
        b"hello\nJ1,J2,J3,J4,J5,J6,J1\n1,2,3,4,5,6,1\n400,3,4,5,6,7,2\n",
        b"time_ms,J1_rad,J2_rad,J3_rad,J4_rad,J5_rad,J6_rad\n0,0,0,0,0,0,0\n8,0,0,0,0,0,1\n40,0,0,0,0,0,1\n",
    ],
    ids=["bare", "twice", "radians"],
)
def test_how_a_file_was_read_and_its_preflight(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(content)
    (trajectory,) = read_trajectories(tmp_path / "a.csv")
    made = resample(trajectory, 0.008)
    lines = [*source_lines(made, WORDS), *PreflightRenderer(words=WORDS).lines(run_preflight(made, 0.008))]
    checks = re.compile(r"^.*a\.csv|\b[a-z-]+:")  # the name of a check stays as it is
    assert {line: left for line in lines if (left := left_over(checks.sub("", line)))} == {}


@pytest.mark.parametrize(
    "content",
    ["function: [", "function: 1", "arguments: []", "function: Robot_Halt\nwhat: 1\n", "a: &b 1\n", "\udc80"],
)
def test_why_a_saved_request_cannot_be_read(content: str, tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(content.encode("utf-8", "surrogateescape"))
    with pytest.raises(SavedRequestError) as raised:
        load_request(path)
    assert JAPANESE.search(WORDS.text(raised.value.message)), str(raised.value)


CLIENT, CONTROLLER = "10.0.0.9:50001", "192.168.0.1:5007"
REFUSED = Message("client.unreachable")


@pytest.mark.parametrize(
    "message",
    [
        Message("rules.faults", count=Count(2, "fault"), seed=3382),
        Message("rules.guard"),
        Message("rules.intercept", limit="60 s"),
        Message("client.denied.datagrams", client=CLIENT, reason=Message("client.not-allowed")),
        Message("client.no-controller", client=CLIENT, controller=CONTROLLER, reason=REFUSED),
        Message("client.lost-at-controller", client=CLIENT, size=100),
        Message("client.refuses-datagrams", controller=CONTROLLER),
        Message("held.message", number=3, note=Message("held.undecided.sent", seconds="30")),
        Message(
            "session.left-open",
            client=CLIENT,
            reason=Message("client.ended"),
            state=Message("session.open.both"),
        ),
        Message("client.silent.slave-mode", client=CLIENT, time="2.0 s"),
        Message(
            "session.not-ended",
            session=Message(
                "session.closed.state",
                session=Message("session.closed.plain", client=CLIENT, controller=CONTROLLER),
                state=Message("session.open.slave-mode"),
            ),
            reason=Message("os.no-answer"),
        ),
        Message("relay.slow", time="3.1 ms", limit="2 ms"),
        Message("control.no-fault", name="'7'", known=Message("control.no-faults")),
    ],
    ids=lambda message: message.id,
)
def test_what_a_proxy_says(message: Message) -> None:
    japanese = WORDS.text(message)
    assert _is_whole(japanese), japanese


@given(st.text(min_size=1, max_size=60).map(printable))
def test_a_name_in_a_sentence_stays_as_it_was_escaped(name: str) -> None:
    message = Message("fault.did", name=name, what=Message("fault.delayed", time="3.1 ms"))
    assert WORDS.text(message) == f"{name}: 3.1 ms 遅延"


@pytest.mark.parametrize(
    "name", ["no", "yes", "error", "the robot's type", "; no", "a: b; c.", "{n}", "{0}", "%s"]
)
def test_no_word_of_a_name_is_ever_exchanged(name: str) -> None:
    message = Message("fault.did", name=name, what=Message("fault.held"))
    assert WORDS.text(message) == f"{name}: 分断が終わるまで保留"


@pytest.mark.parametrize(
    "table",
    [
        enumerations.AUTO_MODES,
        enumerations.MOVE_OPTIONS,
        enumerations.OBJECT_OPTIONS,
        enumerations.PROVIDERS,
        enumerations.SPEED_AXES,
        enumerations.SYS_STATE_BITS,
        enumerations.TASK_START_MODES,
        enumerations.TASK_STATES,
        enumerations.TASK_STOP_MODES,
    ],
)
def test_what_numbers_and_keys_stand_for(table: Mapping[object, str]) -> None:
    texts = {text: JAPANESE_WORDS.text(table_message(text)) for text in table.values()}
    assert [text for text, japanese in texts.items() if japanese == text or left_over(japanese)] == []


def test_a_tree_is_japanese_but_for_names_and_what_is_from_the_wire() -> None:
    words = "handle of a Robot"
    arguments = ROBOT, Variant(VT.BSTR, words), Variant.array(VT.R8, (1.0,) * 40)
    seen = observe(parse_datagram(encode_frame(1, 0, 64, arguments))[0])
    found = [
        row for section in frame_sections(seen, None) for row in field_rows(section, words=JAPANESE_WORDS)
    ]
    texts = {row.name: row.text for row in found}
    assert texts["hRobot"].endswith(", Robot のハンドル")
    assert texts["bstrCommand"] == f'VT_BSTR "{words}"'
    assert texts["vntParam"].endswith("要素 40 個")
    assert "… ほか 8 個" in texts
