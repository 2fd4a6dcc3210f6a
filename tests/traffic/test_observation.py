"""Evidence that shows which end of a conversation is the server."""

from __future__ import annotations

import pytest

from bcapscope.traffic.observation import SERVER_PARTICIPANT, SERVER_PORT, ServerEvidence


@pytest.mark.parametrize("evidence", [SERVER_PARTICIPANT, SERVER_PORT])
def test_only_a_frame_gives_evidence_with_a_code(evidence: ServerEvidence) -> None:
    assert evidence.code == 0
