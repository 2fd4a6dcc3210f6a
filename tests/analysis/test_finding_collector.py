"""Occurrences become findings: causes before consequences, and one finding for what happened often."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bcapscope.analysis.finding import Finding, Severity
from bcapscope.analysis.finding_collector import MAX_FINDINGS, FindingCollector
from bcapscope.analysis.finding_order import MAX_KEPT
from bcapscope.analysis.rules.rule_checker import SECOND, Occurrence
from bcapscope.analysis.rules.rule_table import DiagnosisRule
from bcapscope.messages import Message
from bcapscope.traffic.observation import SERVER_PORT, Conversation, Endpoint, Transport
from tests.samples.findings import sentence_of

HERE = Conversation(Endpoint("10.0.0.2", 50001), Endpoint("10.0.0.1", 5007), Transport.UDP, SERVER_PORT)
ELSEWHERE = Conversation(Endpoint("10.0.0.2", 50001), Endpoint("10.0.0.9", 5007), Transport.UDP, SERVER_PORT)


RULES: dict[str, DiagnosisRule] = {}


def rule(name: str, *follows: str, severity: Severity = Severity.ERROR) -> DiagnosisRule:
    RULES[name] = DiagnosisRule(name, severity, "a paper", follows)
    return RULES[name]


@pytest.fixture(autouse=True)
def rules_of_this_module(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bcapscope.analysis.rules.rule_checker.RULES", RULES)


SPARK, FIRE, SMOKE = rule("spark"), rule("fire", "spark"), rule("smoke", "fire", "spark")


def happen(
    what: DiagnosisRule,
    at: float,
    *,
    call: int = 0,
    because: tuple[int, ...] = (),
    conversation: Conversation = HERE,
    key: str = "",
) -> Occurrence:
    """Make an occurrence that began `at` seconds from the beginning and was over at once."""
    time = round(at * SECOND)
    return Occurrence(
        what.id,
        time,
        time,
        conversation,
        (round(at * 10) + 1,),
        Message.from_table("fact", f"The {what.id} came at {at:.3f} s."),
        Message.from_table("clause", f"{what.id} followed"),
        call,
        because,
        key,
    )


def told(*incidents: Occurrence) -> tuple[Finding, ...]:
    book = FindingCollector()
    for incident in incidents:
        book.add_occurrence(incident)
    return book.findings()


def links(findings: tuple[Finding, ...]) -> list[tuple[str, int | None]]:
    return [(finding.rule, finding.consequence_of) for finding in findings]


def test_nothing_happened() -> None:
    assert told() == ()


def test_a_consequence_stands_behind_its_cause() -> None:
    findings = told(happen(FIRE, 0.2), happen(SPARK, 0.1))
    assert links(findings) == [("spark", None), ("fire", 1)]
    cause, consequence = findings
    assert sentence_of(cause) == "The spark came at 0.100 s. 100 ms later, fire followed."
    assert sentence_of(consequence) == "The fire came at 0.200 s."
    assert (cause.frames, consequence.frames) == ((2,), (3,))


def test_a_chain_is_told_by_its_first_link() -> None:
    findings = told(
        *(happen(SMOKE, 0.3 + number / 10) for number in range(3)), happen(FIRE, 0.2), happen(SPARK, 0.1)
    )
    assert links(findings) == [("spark", None), ("fire", 1), ("smoke", 2)]
    assert sentence_of(findings[0]) == (
        "The spark came at 0.100 s. 100 ms later, fire followed. 100 ms later, smoke followed. "
        "Everything after that is a consequence."
    )


def test_what_else_went_wrong_is_no_consequence() -> None:
    other = rule("flood")
    findings = told(
        happen(SPARK, 0.1), *(happen(FIRE, 0.2 + number / 10) for number in range(3)), happen(other, 0.5)
    )
    assert links(findings) == [("spark", None), ("fire", 1), ("flood", None)]
    assert sentence_of(findings[0]).endswith("100 ms later, fire followed. Finding 2 follows from it.")


def test_what_comes_later_is_no_cause() -> None:
    assert links(told(happen(FIRE, 0.1), happen(SPARK, 0.2))) == [("fire", None), ("spark", None)]


def test_what_is_too_long_ago_is_no_cause() -> None:
    assert links(told(happen(SPARK, 0.1), happen(FIRE, 1.2))) == [("spark", None), ("fire", None)]


def test_what_happened_to_another_controller_is_no_cause() -> None:
    found = told(happen(SPARK, 0.1, conversation=ELSEWHERE), happen(FIRE, 0.2))
    assert links(found) == [("spark", None), ("fire", None)]


def test_a_named_call_is_the_cause_however_long_ago() -> None:
    found = told(happen(SPARK, 0.1, call=7), happen(SPARK, 99.9, call=8), happen(FIRE, 100, because=(7,)))
    assert links(found) == [("spark", None), ("fire", 1)]
    assert sentence_of(found[0]).startswith(
        "The spark came at 0.100 s. This happened twice, from 0.100 s to 99.900 s."
    )


def test_of_several_causes_the_last_one_counts() -> None:
    found = told(happen(SPARK, 0.1), happen(FIRE, 0.2), happen(SMOKE, 0.3))
    assert links(found) == [("spark", None), ("fire", 1), ("smoke", 2)]


def test_of_causes_at_once_the_likelier_counts() -> None:
    first, second = rule("first"), rule("second")
    effect = rule("effect", "second", "first")
    found = told(happen(first, 0.1), happen(second, 0.1), happen(effect, 0.2))
    assert [finding.rule for finding in found if finding.consequence_of] == ["effect"]
    assert found[(found[-1].consequence_of or found[1].consequence_of or 1) - 1].rule == "second"


def test_the_gravest_root_comes_first_with_all_that_follows() -> None:
    spark = rule("spark", severity=Severity.WARNING)
    early = rule("early", severity=Severity.WARNING)
    note = rule("note", severity=Severity.NOTE)
    found = told(happen(note, 0.0), happen(early, 0.05), happen(spark, 0.1), happen(FIRE, 0.2))
    assert links(found) == [("spark", None), ("fire", 1), ("early", None), ("note", None)]


def test_rules_that_follow_each_other_make_no_circle() -> None:
    hen, egg = rule("hen", "egg"), rule("egg", "hen")
    found = told(happen(hen, 0.1), happen(egg, 0.1), happen(hen, 0.2), happen(egg, 0.2))
    assert sorted(finding.rule for finding in found) == ["egg", "hen"]
    assert [finding.consequence_of for finding in found] == [None, 1]


def test_a_thousand_times_are_one_finding() -> None:
    (found,) = told(*(happen(SPARK, number / 10) for number in range(1000)))
    assert sentence_of(found) == (
        "The spark came at 0.000 s. This happened 1000 times, from 0.000 s to 99.900 s."
    )
    assert found.frames == (1, 1000)


def test_the_time_that_had_consequences_is_told() -> None:
    sparks = [happen(SPARK, 2.0 * number) for number in range(20)]
    found = told(*sparks, happen(FIRE, 20.5))
    assert links(found) == [("spark", None), ("fire", 1)]
    assert sentence_of(found[0]).startswith(
        "The spark came at 20.000 s. This happened 20 times, from 0.000 s to 38.000 s."
    )
    assert found[0].frames == (1, 201, 381)


def test_a_cause_in_the_middle_of_a_flood_is_known_when_it_matters() -> None:
    sparks = [happen(SPARK, 2.0 * number) for number in range(10 * MAX_KEPT)]
    middle = 5 * MAX_KEPT
    found = told(*sparks[:middle], happen(FIRE, 2.0 * middle - 1.5), *sparks[middle:])
    assert links(found) == [("spark", None), ("fire", 1)]
    assert sentence_of(found[0]).startswith("The spark came at 318.000 s. This happened 320 times")


def test_keys_tell_findings_of_a_rule_apart_up_to_a_number() -> None:
    found = told(*(happen(SPARK, number / 100, key=str(number)) for number in range(MAX_FINDINGS + 10)))
    assert len(found) == MAX_FINDINGS
    assert "This happened 11 times" in sentence_of(found[0])


def test_what_follows_at_once_needs_no_time() -> None:
    found = told(happen(SPARK, 0.1), happen(FIRE, 0.1))
    assert sentence_of(found[0]) == "The spark came at 0.100 s. Then fire followed."


def test_names_from_the_wire_keep_their_first_letter() -> None:
    occurrence = happen(SPARK, 0.1)
    occurrence.fact = Message.from_table("fact", "slvMove 7 was lost.")
    assert sentence_of(told(occurrence)[0]) == "slvMove 7 was lost."


def test_news_tell_each_case_once_and_by_itself() -> None:
    book = FindingCollector()
    book.add_occurrence(happen(SPARK, 1))
    book.add_occurrence(happen(FIRE, 2))
    first = book.new_findings()
    sentences = [sentence_of(finding) for finding in first]
    assert sentences == ["The spark came at 1.000 s.", "The fire came at 2.000 s."]
    book.add_occurrence(happen(FIRE, 3))
    assert book.new_findings() == ()
    book.add_occurrence(happen(SMOKE, 4))
    assert [finding.rule for finding in book.new_findings()] == ["smoke"]
    assert {finding.rule for finding in book.findings()} == {"spark", "fire", "smoke"}


def test_provisional_occurrences_count_for_one_answer_only() -> None:
    collector = FindingCollector()
    collector.add_occurrence(happen(FIRE, 0.2))
    before = collector.findings()
    assert links(before) == [("fire", None)]
    for _ in range(2):
        found = collector.findings([happen(SPARK, 0.1), happen(FIRE, 0.3)])
        assert links(found) == [("spark", None), ("fire", 1)]
        assert "This happened twice" in sentence_of(found[1])
    assert collector.findings() == before
    assert [finding.rule for finding in collector.new_findings()] == ["fire"]


def test_asking_again_and_again_changes_nothing_that_follows() -> None:
    asked, never_asked = FindingCollector(), FindingCollector()
    occurrences = [
        happen(what, number / 10, call=number, because=(number - 1,))
        for number in range(1, 10 * MAX_KEPT)
        for what in (SPARK, FIRE, SMOKE)
    ]
    for collector in (asked, never_asked):
        for occurrence in occurrences:
            collector.add_occurrence(occurrence)
            if collector is asked:
                collector.findings()
    assert asked.findings() == never_asked.findings()


def test_an_update_replaces_its_occurrence_as_cause_and_as_consequence() -> None:
    def update(occurrence: Occurrence, text: str) -> Occurrence:
        return replace(occurrence, fact=Message.from_table("fact", text), is_update=True)

    collector = FindingCollector()
    spark, fire = happen(SPARK, 0.1, call=1), happen(FIRE, 0.2, call=2)
    for occurrence in (spark, fire, happen(SMOKE, 0.3, call=3, because=(2,))):
        collector.add_occurrence(occurrence)
    collector.add_occurrence(update(spark, "A bigger spark."))
    collector.add_occurrence(update(fire, "A bigger fire."))
    collector.add_occurrence(update(fire, "The biggest fire."))
    found = collector.findings()
    assert links(found) == [("spark", None), ("fire", 1), ("smoke", 2)]
    assert [sentence_of(finding) for finding in found[:2]] == [
        "A bigger spark. 100 ms later, fire followed. 100 ms later, smoke followed.",
        "The biggest fire.",
    ]
    assert "in all" not in sentence_of(found[1])


def test_an_update_of_an_occurrence_that_is_not_kept_is_ignored() -> None:
    occurrences = [happen(SPARK, number / 10, call=number) for number in range(1, 10 * MAX_KEPT)]
    middle = replace(
        occurrences[5 * MAX_KEPT], fact=Message.from_table("fact", "another one"), is_update=True
    )
    assert told(*occurrences, middle) == told(*occurrences)
