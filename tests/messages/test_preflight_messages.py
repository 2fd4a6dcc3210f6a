"""Problems of the pre-flight in Japanese."""

from __future__ import annotations

import re

import pytest

from bcapscope.messages import Language, MessageFormatter
from bcapscope.player.checks import PreflightProblem
from tests.player.test_preflight import FAULTS

WORDS = MessageFormatter(Language.JAPANESE)
PROBLEMS = [problem for fault in FAULTS for problem in fault.preflight.problems]
JAPANESE, NUMBERS = re.compile("[ぁ-んァ-ヶ一-龥]"), re.compile(r"\d+(?:\.\d+)?")


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda problem: str(problem.check))
def test_a_problem_is_japanese_with_all_of_its_numbers(problem: PreflightProblem) -> None:
    japanese = WORDS.text(problem.fact)
    assert JAPANESE.search(japanese)
    assert set(NUMBERS.findall(str(problem.fact))) <= set(NUMBERS.findall(japanese))
    assert problem.advice is None or JAPANESE.search(WORDS.text(problem.advice))
