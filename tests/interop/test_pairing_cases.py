"""Captures that an independent generator made, each of one situation, with what was really the case."""

from __future__ import annotations

import pytest

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.finding import Severity
from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.traffic.call import Call
from bcapscope.traffic.pipeline import CallCollector, Pipeline
from tests.shared_folder import SHARED

pytestmark = pytest.mark.interop

CASES = SHARED / "cases"

if not CASES.exists():
    pytest.skip(f"{CASES} is missing: captures of an independent generator", allow_module_level=True)


def read(name: str) -> tuple[list[Call], Diagnosis]:
    """Return the calls of a capture, and its diagnosis."""
    diagnosis, collector, decoder = Diagnosis(), CallCollector(), PacketDecoder()
    pipeline = Pipeline(diagnosis, collector)
    with open_capture(CASES / name) as capture:
        for observation in decoder.decode(capture):
            pipeline.add(observation)
    pipeline.finish(decoder.end_time)
    return collector.calls, diagnosis


def rules(diagnosis: Diagnosis, *severities: Severity) -> list[str]:
    return [finding.rule for finding in diagnosis.findings() if finding.severity in severities]


def test_a_reply_after_the_client_gave_up() -> None:
    calls, diagnosis = read("reply-after-client-gave-up.pcap")
    call = calls[110]
    assert (call.retries, call.outcome, call.verdict) == (2, "unanswered", "reply late")
    first, *others = diagnosis.findings()
    assert first.rule == "client-gave-up"
    assert next(each for each in others if each.rule == "set-point-gap").consequence_of == 1
    assert "retried" not in [each.rule for each in others]


@pytest.mark.parametrize("name", ["tcp-capture-lacks-reply.pcap", "tcp-capture-lacks-request.pcap"])
def test_a_segment_that_the_capture_lacks_is_nobodys_fault(name: str) -> None:
    calls, diagnosis = read(name)
    assert rules(diagnosis, *Severity) == ["capture-gap"]
    assert "unanswered" not in [call.outcome for call in calls]


def test_a_capture_of_one_direction() -> None:
    calls, diagnosis = read("requests-only.pcap")
    assert rules(diagnosis, *Severity) == ["one-direction"]
    assert {call.outcome for call in calls} == {"not_captured"}


def test_a_reply_that_may_have_crossed_the_retry() -> None:
    calls, diagnosis = read("reply-crossed-retry-at-controller.pcap")
    assert calls[5].verdict == "cannot tell"
    assert rules(diagnosis, *Severity) == ["retried"]


def test_a_chained_attempt_that_was_not_captured() -> None:
    calls, diagnosis = read("chain-unseen-attempt.pcap")
    call = calls[4]
    assert (call.serials, call.unseen_serials, call.outcome) == ((20, 22), (21,), "answered")
    assert rules(diagnosis, Severity.ERROR) == []
    assert rules(diagnosis, Severity.WARNING) == ["retried"]
