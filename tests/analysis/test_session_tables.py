"""Tables of whole sessions: the first cause of each faulty one is right, and each healthy one is silent."""

from __future__ import annotations

import pytest

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
