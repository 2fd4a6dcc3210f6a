"""Whatever rooms below say on a screen is in Japanese: as their modules have it, and as it comes out."""

from __future__ import annotations

import importlib
import io
import json
import pkgutil
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.analysis import rules
from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.analysis.statistics.call_statistics import StatisticsBuilder
from bcapscope.capture.capture_file import CaptureFile
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.messages import Language, MessageFormatter
from bcapscope.player.preflight import run_preflight
from bcapscope.player.resampling import resample
from bcapscope.player.trajectory import TrajectoryError
from bcapscope.player.trajectory_reader import read_trajectories
from bcapscope.protocol.codec.frame import encode_frame, parse_datagram
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables import enumerations
from bcapscope.protocol.tables.table_text import table_message
from bcapscope.render.escape import printable
from bcapscope.render.frame_outline import field_rows, frame_sections
from bcapscope.render.preflight_text import PreflightRenderer, source_lines
from bcapscope.render.slave_session_text import slave_session_lines
from bcapscope.render.statistics_text import statistics_lines
from bcapscope.traffic.pipeline import Pipeline
from bcapscope.tui.controller_access.saved_requests import SavedRequestError, load_request
from bcapscope.tui.reader_language import localized, reader_words
from tests.analysis.plays import SCENES
from tests.analysis.scenes import Story
from tests.cli.run import CAPTURES
from tests.render.scenes import ROBOT, observe
from tests.tui.words.english import left_over, untold

WORDS = MessageFormatter(Language.JAPANESE)

pytestmark = pytest.mark.usefixtures("japanese_screen")

JAPANESE = re.compile("[ぁ-んァ-ヶ一-龥]")

RULES = [each.name for each in pkgutil.iter_modules(rules.__path__, f"{rules.__name__}.")]
ROOMS = {
    "analysis": "finding_collector",
    "capture": "packet_decoder",
    "faults": "fault_effects fault_injector fault_notation quantities",
    "protocol": "codec.arguments codec.frame_content codec.stream_splitter",
    "proxy": "control_api control_client intercept relay request_guard script_process script_queue "
    "session_closer silence_monitor tcp_session udp_listener",
    "render": "frame_line result_advice statistics_text",
    "traffic": "filter.compiler filter.tokens",
}
MODULES = (*RULES, *(f"bcapscope.{room}.{name}" for room, names in ROOMS.items() for name in names.split()))
"""Those whose sentences a screen shows."""

UNSEEN = {
    "bcapscope.protocol.codec.frame_content": ["serial line"],  # a name
    "bcapscope.proxy.request_guard": [
        "there is no function or command ",
        "a command that is not in the catalogue is written with its function, Robot_Execute:",
        " takes no commands",
        "these do",
    ],  # of the command line, before there is a screen
}
"""What is no sentence."""


@pytest.mark.parametrize("module", MODULES)
def test_every_clause_that_a_module_has_is_in_a_phrase(module: str) -> None:
    assert untold(importlib.import_module(module)) == UNSEEN.get(module, [])


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
    assert JAPANESE.search(str(raised.value)), str(raised.value)


@pytest.mark.parametrize(
    "text",
    [
        "127.0.0.1:5008 UDP and TCP > 192.168.0.1:5007; only this machine reaches it",
        "2 faults, --seed 3382",
        "guard: the proxy refuses forbidden requests with E_ACCESSDENIED",
        "intercept: messages are held until you release them, at most 60 s",
        "10.0.0.9 is not allowed; its datagrams are dropped",
        "10.0.0.9:50001: the controller 192.168.0.1:5007 cannot be reached: no route to host",
        "10.0.0.9:50001: 100 bytes were not taken by the controller any more",
        "192.168.0.1:5007 refuses datagrams: nobody listens on UDP there (ICMP)",
        "message 3: intercept: nobody decided in 30 s, sent on unchanged",
        "10.0.0.9:50001 is gone (ended by both sides) while slave mode is on and the arm is held",
        "10.0.0.9:50001 has sent nothing for 2.0 s while slave mode is on",
        "the session of 10.0.0.9:5001 at 10.0.0.1:57, where slave mode is on, could not be ended: no answer",
        "the proxy itself held something for 3.1 ms, longer than the 2 ms in which a set point has to be "
        "answered",
        "cannot listen on 127.0.0.1:5008 UDP: address already in use",
        "there is no fault 'x': there are none",
    ],
)
def test_what_a_proxy_says(text: str) -> None:
    japanese = localized(text)
    assert _is_whole(japanese), japanese


@given(st.text(min_size=1, max_size=60).map(printable))
def test_a_name_in_a_sentence_stays_as_it_was_escaped(name: str) -> None:
    assert localized(f"{name}: delayed by 3.1 ms") == f"{name}: 3.1 ms 遅延"


@pytest.mark.parametrize(
    "name", ["no", "yes", "error", "the robot's type", "; no", "a: b; c.", "{n}", "{0}", "%s"]
)
def test_no_word_of_a_name_is_ever_exchanged(name: str) -> None:
    phrase = f"{name}: held until the partition ends"
    assert localized(phrase) == f"{name}: 分断が終わるまで保留"


@pytest.mark.parametrize("text", ["Something that nobody has said yet.", "x" * 5000, "a; b: c, d"])
def test_what_is_not_known_is_shown_as_it_is(text: str) -> None:
    assert localized(text) == text


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
