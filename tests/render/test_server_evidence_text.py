"""The evidence for a controller, in both languages."""

from __future__ import annotations

import pytest

from bcapscope.messages import Language, MessageFormatter
from bcapscope.render.server_evidence_text import server_evidence_message
from bcapscope.traffic.observation import (
    Conversation,
    Endpoint,
    ServerEvidence,
    ServerEvidenceKind,
    Transport,
)

KINDS = ServerEvidenceKind


def text(evidence: ServerEvidence, language: Language = Language.ENGLISH) -> str:
    ends = Endpoint("10.0.0.2", 50001), Endpoint("10.0.0.1", 7000)
    conversation = Conversation(*ends, Transport.TCP, evidence)
    return MessageFormatter(language).text(server_evidence_message(conversation))


@pytest.mark.parametrize(
    ("evidence", "words"),
    [
        (ServerEvidence(KINDS.PORT), "port 7000"),
        (ServerEvidence(KINDS.HANDSHAKE), "it accepted the TCP connection"),
        (
            ServerEvidence(KINDS.RESULT, 0x83201483),
            "10.0.0.1:7000 sent the result 0x83201483, which no request can carry",
        ),
        (ServerEvidence(KINDS.CALL, 64), "10.0.0.2:50001 sent a call of Robot_Execute with its arguments"),
    ],
)
def test_the_evidence_names_what_was_seen(evidence: ServerEvidence, words: str) -> None:
    assert text(evidence) == words


@pytest.mark.parametrize("kind", ServerEvidenceKind)
def test_each_kind_of_evidence_has_words_in_both_languages(kind: ServerEvidenceKind) -> None:
    english, japanese = (text(ServerEvidence(kind, 64), language) for language in Language)
    assert english != japanese
    assert "server-by" not in english + japanese
