"""A frame that was captured on both legs of a proxy is at home in its call, whichever leg is looked at."""

from __future__ import annotations

from bcapscope.traffic.filter.getters import AnnotatedFrame
from bcapscope.tui.screens.frame_relations import call_frames, find_partner, frame_description
from tests.traffic.joining.two_places import ProxiedScript
from tests.traffic.playbook import MOVE, Script, calls_of


def test_every_sighting_of_a_frame_belongs_to_the_call() -> None:
    script = ProxiedScript()
    client = script.proxied_client()
    client.calls(0, 3, MOVE)
    client.ask(50, 10, 0, MOVE, lost=True)
    client.ask(58, 11, 10, MOVE)
    client.reply(59, 11)
    client.calls(100, 2, MOVE, 20)
    call = script.calls()[3]
    seen = {each.number: each for each in script.in_order()}
    assert call_frames(call) == {13, 14, 15, 16, 17}
    partners = {13: 17, 14: 17, 15: 17, 16: 14, 17: 14}
    roles = {13: "request", 14: "retry", 15: "retry", 16: "reply", 17: "reply"}
    for number, partner in partners.items():
        described = frame_description(AnnotatedFrame(seen[number], call.kind), call, None)
        assert roles[number] in described
        assert find_partner(call, number) == (partner, "")


def test_a_packet_that_was_captured_twice_says_so() -> None:
    script = Script()
    client = script.client()
    client.ask(0, 1, 0, MOVE)
    again = client.ask(0.1, 1, 0, MOVE)
    client.reply(1, 1)
    (call,) = calls_of(script.track())
    assert "recaptured" in frame_description(AnnotatedFrame(again, call.kind), call, None)
