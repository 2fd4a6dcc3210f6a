"""Tables of whole sessions: the first cause of each faulty one is right, and each healthy one is silent."""

from __future__ import annotations

import pytest

from tests.analysis.faulty_sessions import FAULTY_SESSIONS, FaultySession
from tests.analysis.healthy_sessions import HEALTHY_SESSIONS, HealthySession
from tests.samples.findings import sentence_of


@pytest.mark.parametrize("healthy", HEALTHY_SESSIONS, ids=lambda each: f"{each.name}, {each.style.name}")
def test_a_healthy_session_has_no_findings(healthy: HealthySession) -> None:
    found = healthy.diagnose()
    told = [f"{each.severity} {each.rule}: {sentence_of(each, found.seen)}" for each in found.findings]
    assert [each.rule for each in found.findings] == list(healthy.notes), told
    assert found.seen.calls


def test_there_are_many_healthy_sessions() -> None:
    assert len(HEALTHY_SESSIONS) >= 150
    assert len({(each.name, each.style) for each in HEALTHY_SESSIONS}) == len(HEALTHY_SESSIONS)


@pytest.mark.parametrize("faulty", FAULTY_SESSIONS, ids=lambda each: each.name)
def test_the_first_cause_of_a_faulty_session_is_right(faulty: FaultySession) -> None:
    found = faulty.diagnose()
    told = [
        f"{number} {each.rule} < {each.consequence_of}: {sentence_of(each, found.seen)}"
        for number, each in enumerate(found.findings, 1)
    ]
    assert found.findings, "no finding"
    assert found.findings[0].rule == faulty.cause, told


def test_there_are_many_faulty_sessions() -> None:
    assert len(FAULTY_SESSIONS) >= 90
    assert len({each.name for each in FAULTY_SESSIONS}) == len(FAULTY_SESSIONS)
    assert len({each.cause for each in FAULTY_SESSIONS}) >= 35
