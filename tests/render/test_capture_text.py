"""What became of packets, and the evidence for a controller, in both languages."""

from __future__ import annotations

from collections import Counter

import pytest

from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.messages import Language, MessageFormatter
from bcapscope.render.capture_text import capture_counts_text, server_evidence_message
from bcapscope.traffic.observation import (
    Conversation,
    Endpoint,
    ServerEvidence,
    ServerEvidenceKind,
    Transport,
)

KINDS = ServerEvidenceKind


def test_only_what_was_met_is_told() -> None:
    assert capture_counts_text(CaptureCounts(packets=1, items=1)) == "1 frame in 1 packet"


def test_everything_that_can_be_met() -> None:
    counts = CaptureCounts(
        packets=100,
        items=50,
        malformed=2,
        gaps=1,
        missing=7,
        not_ip=1,
        broken=3,
        not_bcap=4,
        cut=1,
        fragments_lost=2,
        contradictions=1,
        unknown_links=Counter({147: 5}),
    )
    assert capture_counts_text(counts) == (
        "47 frames in 100 packets; 2 malformed; 1 gap, 7 bytes missing; 5 packets of other protocols; "
        "1 packet cut short by the capture; 3 packets with damaged headers; "
        "2 datagrams with missing fragments; "
        "1 TCP segment sent again with different bytes; "
        "5 packets of link type 147, which bcapscope does not know"
    )


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
