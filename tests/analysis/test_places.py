"""Findings about calls that two places captured say where their frames were lost."""

from __future__ import annotations

import pytest

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.finding import Finding
from bcapscope.traffic.joining.joiner import Joiner
from bcapscope.traffic.observation import Direction, Transport
from bcapscope.traffic.pipeline import Pipeline
from tests.samples.findings import sentence_of
from tests.traffic.joining.two_places import START_SERVICE, ProxiedScript
from tests.traffic.playbook import MS, OTHER, execute

POLL = execute("CurJnt")


def findings_of(script: ProxiedScript, rule: str) -> list[Finding]:
    diagnosis = Diagnosis()
    pipeline = Pipeline(diagnosis, joiner=Joiner())
    for seen in script.in_order():
        pipeline.add(seen)
    pipeline.finish()
    return [finding for finding in diagnosis.findings() if finding.rule == rule]


@pytest.mark.parametrize("reset", [False, True])
def test_a_controller_that_ends_its_leg_is_named_and_so_is_the_proxy(reset: bool) -> None:
    script = ProxiedScript()
    client = script.proxied_client(transport=Transport.TCP)
    client.call(0, 1, START_SERVICE)
    client.calls(8, 10, POLL, 2)
    end = script.in_order()[-1].time
    client.far.conversation.record_end(Direction.RESPONSE, reset, end + MS)
    client.near.conversation.record_end(Direction.RESPONSE, reset, end + 2 * MS)
    (found,) = findings_of(script, "controller-hung-up")
    how = "reset" if reset else "closed"
    assert f"10.0.0.1:5007 {how} the connection" in sentence_of(found)
    assert f"the proxy 10.0.0.3:5008 {how} the connection" in sentence_of(found)


def test_a_connection_that_the_proxy_ends_is_not_held_against_the_controller() -> None:
    script = ProxiedScript()
    client = script.proxied_client(transport=Transport.TCP)
    client.call(0, 1, START_SERVICE)
    client.calls(8, 10, POLL, 2)
    end = script.in_order()[-1].time
    client.near.conversation.record_end(Direction.RESPONSE, reset=False, time=end + MS)
    client.far.conversation.record_end(Direction.REQUEST, reset=False, time=end + 2 * MS)
    (found,) = findings_of(script, "controller-hung-up")
    assert "the proxy 10.0.0.3:5008 ended the connection" in sentence_of(found)
    assert "The controller did not cause this" in str(found.advice)


def test_a_request_without_reply_that_reached_the_controllers_side() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.call(0, 1, START_SERVICE)
    client.calls(8, 10, POLL, 2)
    client.ask(200, 20, 0, OTHER)
    client.calls(1300, 10, POLL, 30)
    (found,) = findings_of(script, "no-reply")
    assert "was captured at the controller's side, but no reply was" in sentence_of(found)
    assert "does not show" not in sentence_of(found)
    assert "Check the controller" in str(found.advice)


def test_a_request_without_reply_that_the_proxy_did_not_forward() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.call(0, 1, START_SERVICE)
    client.calls(8, 10, POLL, 2)
    client.ask(200, 20, 0, OTHER, lost=True)
    client.calls(1300, 10, POLL, 30)
    (found,) = findings_of(script, "no-reply")
    assert "The proxy received 1 frame of this call that it did not forward" in sentence_of(found)
    assert "cable" not in str(found.advice)


def test_a_reply_that_the_proxy_did_not_forward_did_not_cross_a_retry() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.call(0, 1, START_SERVICE)
    client.calls(8, 10, POLL, 2)
    client.ask(200, 20, 0, OTHER, lost=True)
    client.ask(250, 21, 20, OTHER)
    client.reply(251, 21, lost=True)
    client.ask(300, 22, 20, OTHER)
    client.reply(301, 22)
    client.calls(400, 10, POLL, 30)
    (found,) = findings_of(script, "retried")
    assert "The proxy received 2 frames of this call that it did not forward" in sentence_of(found)
    assert "cross" not in sentence_of(found)
