"""Findings in Japanese: nothing is lost between the languages."""

from __future__ import annotations

import re

import pytest

from bcapscope.analysis.finding import Severity, TrafficTotals
from bcapscope.analysis.rules.rule_table import RULES
from bcapscope.messages import Language, MessageFormatter
from bcapscope.messages.message import has_message
from bcapscope.render.findings import diagnosis_summary
from tests.analysis.plays import SCENES
from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import stage
from tests.samples.findings import sentence_of

JAPANESE = re.compile("[ぁ-んァ-ヶ一-龥]")
WORDS = MessageFormatter(Language.JAPANESE)
_NUMBERS = re.compile(r"\d+\.\d+|0x[0-9A-F]+|\b\d{2,}\b")


@pytest.mark.parametrize("scene", SCENES, ids=[f"{scene.rule}-{at}" for at, scene in enumerate(SCENES)])
def test_every_finding_of_a_scene_is_japanese_with_all_of_its_numbers(scene: Scene) -> None:
    findings, seen = stage(scene.fires)
    for finding in findings:
        english, japanese = sentence_of(finding, seen), sentence_of(finding, seen, WORDS)
        assert JAPANESE.search(japanese)
        assert japanese.endswith("。")
        assert JAPANESE.search(WORDS.text(finding.advice))
        assert [number for number in _NUMBERS.findall(english) if number not in japanese] == []
        for text in (english, japanese):
            assert "{" not in text


@pytest.mark.parametrize("rule", RULES.values(), ids=lambda rule: rule.id)
def test_every_rule_has_a_title_and_an_advice(rule: object) -> None:
    assert has_message(f"rule.{rule.id}.title")  # type: ignore[attr-defined]
    assert has_message(f"rule.{rule.id}.advice")  # type: ignore[attr-defined]


def test_the_sum_of_all() -> None:
    seen = TrafficTotals(518, 257, 1, 5_200_000_000)
    assert diagnosis_summary([Severity.ERROR, Severity.NOTE], seen, words=WORDS) == (
        "エラー 1 件、注記 1 件、対象: フレーム 518 個、呼び出し 257 件、クライアント 1 台、5.2 s"
    )
    assert JAPANESE.search(diagnosis_summary([], TrafficTotals(0, 0, 0, 0), words=WORDS))
