"""Every rule fires on its capture, names the frames that prove it, and is silent where nothing is wrong."""

from __future__ import annotations

import ast
import io
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bcapscope.analysis import rules
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.rule_table import RULES, DiagnosisRule
from bcapscope.capture.capture_file import CaptureFile
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.protocol.tables.table_rows import table_rows
from bcapscope.traffic.observation import Direction
from tests.analysis.plays import SCENES
from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import Story, diagnose, diagnose_bytes, good, stage
from tests.samples import guide, slave, tcp, trouble
from tests.samples.calls import MS, START, request, text
from tests.samples.findings import sentence_of

_NAMES = [f"{scene.rule}-{number}" for number, scene in enumerate(SCENES)]


@pytest.mark.parametrize("scene", SCENES, ids=_NAMES)
def test_a_rule_fires_and_says_why(scene: Scene) -> None:
    found = stage(scene.fires)
    (finding,) = found.of(scene.rule)
    assert finding.frames == scene.frames
    for words in scene.words:
        assert words in sentence_of(finding, found.seen)
    cause = found.findings[finding.consequence_of - 1].rule if finding.consequence_of else ""
    assert cause == scene.cause


@pytest.mark.parametrize("scene", SCENES, ids=_NAMES)
def test_a_rule_stays_silent_where_there_is_no_need(scene: Scene) -> None:
    assert stage(scene.calm).of(scene.rule) == []


@pytest.mark.parametrize("scene", SCENES, ids=_NAMES)
def test_findings_are_sentences_about_frames_that_there_are(scene: Scene) -> None:
    findings, seen = stage(scene.fires)
    for number, finding in enumerate(findings, 1):
        sentence = sentence_of(finding, seen)
        assert sentence.endswith(".")
        assert not sentence[0].isspace()
        assert str(finding.advice).endswith(".")
        assert finding.source
        assert finding.frames
        assert list(finding.frames) == sorted(set(finding.frames))
        assert finding.frames[0] >= 1
        assert finding.frames[-1] <= seen.frames
        assert finding.consequence_of is None or 1 <= finding.consequence_of < number


def test_each_rule_has_a_scene() -> None:
    assert {scene.rule for scene in SCENES} == set(RULES)


def test_there_are_many_rules_each_with_a_name_of_its_own() -> None:
    assert len(RULES) >= 30
    assert [row["id"] for row in table_rows("rules", os.path.dirname(rules.__file__))] == list(RULES)


_FUNCTIONS_WITH_A_RULE = (
    *("report_call", "_report_with_place", "_report_frame", "_off_pace"),
    *("Refusal", "Occurrence"),
)
"""The first argument of each of these functions is a rule."""


def _named_rules(module: Path) -> Iterator[str]:
    """Yield each rule that a module names where it reports a problem or describes a refusal."""
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call) or not node.args:
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name not in _FUNCTIONS_WITH_A_RULE:
            continue
        for each in ast.walk(node.args[0]):
            if isinstance(each, ast.Constant) and isinstance(each.value, str):
                yield each.value


def test_the_code_names_rules_that_there_are() -> None:
    modules = Path(str(rules.__file__)).parent.glob("*_rules.py")
    named = {rule for module in modules for rule in _named_rules(module)}
    assert named <= set(RULES)
    assert len(named) > 0.9 * len(RULES)


def test_rules_follow_rules_that_there_are() -> None:
    for rule in RULES.values():
        assert set(rule.possible_causes) <= set(RULES)
        assert rule.id not in rule.possible_causes


@pytest.mark.parametrize("rule", RULES.values(), ids=lambda rule: rule.id)
def test_the_text_of_a_rule_fits_a_table_and_a_sentence(rule: DiagnosisRule) -> None:
    for each in (str(rule.title), rule.source):
        assert "|" not in each
        assert "\n" not in each
    assert str(rule.advice)[0].isupper()


@pytest.mark.parametrize(
    "capture",
    [
        pytest.param(slave.slave_session, id="slave mode"),
        pytest.param(guide.exchanges, id="the guide's exchanges"),
        pytest.param(trouble.vlan_ipv6, id="VLAN and IPv6"),
        pytest.param(trouble.two_robots, id="two robots"),
        pytest.param(tcp.segments, id="TCP"),
    ],
)
def test_good_captures_have_neither_errors_nor_warnings(capture: Callable[[], bytes]) -> None:
    found = diagnose_bytes(capture())
    assert [finding for finding in found.findings if finding.severity is not Severity.NOTE] == []


@pytest.mark.parametrize("direction", Direction)
@pytest.mark.parametrize("capture", [slave.slave_session, trouble.two_robots, tcp.segments])
def test_one_direction_of_a_good_capture_has_neither_errors_nor_warnings(
    capture: Callable[[], bytes], direction: Direction
) -> None:
    whole = PacketDecoder(frozenset({5007})).decode(CaptureFile(io.BytesIO(capture())))
    found = diagnose([seen for seen in whole if seen.flow.direction is direction])
    assert [finding.rule for finding in found.findings if finding.severity is not Severity.NOTE] == []


def test_a_good_session_has_no_findings_at_all() -> None:
    assert stage(good).findings == ()


def test_the_advice_on_bytes_that_are_no_frame_is_for_their_transport() -> None:
    def play(story: Story) -> None:
        for number, over_tcp in enumerate((False, True)):
            client = story.client(50001 + number, tcp=over_tcp)
            client.open(number * 100)
            client.network.up(START + (number * 100 + 50) * MS, b"\x01\x02" + request(9, 0, "Service_Stop"))

    first, second = stage(play).of("malformed-request")
    assert "can stop DENSO's C server" in sentence_of(first)
    assert "stops the UDP service" in str(first.advice)
    assert "stop DENSO's C server" not in sentence_of(second)
    assert "UDP" not in str(second.advice)
    assert "Over TCP" in str(second.advice)


@pytest.mark.parametrize(("goes_on_after", "rule"), [(None, "client-stopped"), (9000, "no-reply")])
def test_a_call_that_was_given_up_is_found_once(goes_on_after: float | None, rule: str) -> None:
    """By the end of the traffic, or by the next call of the client, even one that is answered at once."""

    def play(story: Story) -> None:
        client = story.client()
        client.open()
        first = client.ask(50, "Service_Stop")
        client.ask(66, "Service_Stop", reserved=first)
        story.client(50002).call(8000, "Service_Start", text(",WDT=400"))
        if goes_on_after is not None:
            client.execute(goes_on_after, "CurJnt", result=text(""))

    rules = [finding.rule for finding in stage(play).findings]
    assert [each for each in rules if each in ("no-reply", "client-stopped", "controller-silent")] == [rule]


def test_arguments_that_are_unusual_in_different_ways_are_different_findings() -> None:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        for number, mode in enumerate(("514", "514", "515")):
            client.execute(30 + 10 * number, "slvChangeMode", text(mode))
        client.close(100)

    found = stage(play).of("unusual-argument")
    assert [finding.repetition and finding.repetition.count for finding in found] == [2, None]
    assert ["'514'" in sentence_of(each) for each in found] == [True, False]
