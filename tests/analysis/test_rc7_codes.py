"""RC7's four-digit codes fire the same rules in both 32-bit forms; the second form is marked as a guess."""

from __future__ import annotations

import pytest

from tests.analysis.scenes import Play, Story, stage
from tests.samples.calls import i2, i4s
from tests.samples.findings import sentence_of

_RULES = (
    (0x21F3, "not-in-automatic-mode"),
    (0x21E7, "not-in-automatic-mode"),
    (0x21DE, "not-in-automatic-mode"),
    (0x2254, "refused-in-slave-mode"),
    (0x2006, "motor-off"),
    (0x2008, "emergency-stop"),
    (0x21EE, "emergency-stop"),
    (0x21F7, "arm-not-taken"),
    (0x2287, "no-executable-token"),
    (0x2289, "no-executable-token"),
    (0x21D3, "error-not-cleared"),
    (0x600B, "robot-still-moving"),
    (0x671A, "underflow"),
    (0x607F, "invalid-set-point"),
)


def _refuses(command: str, code: int) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open(option="", provider="")
        client.execute(40, command, i2(2) if command == "slvChangeMode" else i4s(1, 0), code=code)
        client.close(60)

    return play


@pytest.mark.parametrize("command", ["Motor", "slvChangeMode"])
@pytest.mark.parametrize(("number", "rule"), _RULES)
def test_both_forms_of_a_code_fire_the_rule_of_its_meaning(number: int, rule: str, command: str) -> None:
    plain, guessed = (stage(_refuses(command, form | number)).findings for form in (0, 0x80000000))
    assert [finding.rule for finding in plain if finding.severity == "error"] == [rule]
    assert [finding.rule for finding in guessed] == [finding.rule for finding in plain]
    marked = f"reads this code as RC7's {number:04X}. This is a guess"
    assert [marked in sentence_of(finding) for finding in guessed if finding.rule == rule] == [True]
    assert not any("guess" in sentence_of(finding) for finding in plain)


@pytest.mark.parametrize("code", [0x80004001, 0x80004005, 0x80000900, 0x83501024])
def test_a_code_that_is_known_is_not_read_as_a_code_of_rc7(code: int) -> None:
    assert not any("RC7's" in sentence_of(finding) for finding in stage(_refuses("Motor", code)).findings)
