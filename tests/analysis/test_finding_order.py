"""What stopped the robot comes first, then what kept it from moving. A client's findings stand together."""

from __future__ import annotations

from tests.analysis.scenes import ROBOT, Play, Story, Talker, stage
from tests.samples.calls import i4, i4s, text

_UNDERFLOW, _OUTSIDE, _BUSY, _NO_COMMAND = 0x84201482, 0x83500121, 0x80010004, 0x80000904


def _stops_in_motion(client: Talker, start: float) -> None:
    client.open(start)
    client.ready(start + 20)
    client.enter(start + 40)
    at = client.move(start + 50, 250)
    client.point(at + 100, 250 * 0.05, _UNDERFLOW)
    client.point(at + 108, 250 * 0.05, _OUTSIDE)
    client.control(at + 120, "GetCurErrorCount")
    client.control(at + 130, "ClearError")
    client.close(at + 140)


def _two_clients(story: Story) -> None:
    """Client B has harmless refusals 1.8 s before and after the stop of A."""
    other, client = story.client(50002, host="192.168.0.11"), story.client()
    other.open(5)
    other.execute(300, "CurrJnt", code=_NO_COMMAND)
    other.execute(310, "ExtSpeed", i4s(10, 0), code=0x80070057)
    _stops_in_motion(client, 20)
    client.serial = 500
    other.execute(2600, "GetSrvDat", code=_NO_COMMAND)
    other.close(2700)


def test_the_stop_of_one_client_stands_above_a_harmless_refusal_of_another() -> None:
    found = stage(_two_clients)
    assert [(each.rule, each.conversation.client.port) for each in found.findings] == [
        ("set-point-gap", 50001),
        ("underflow", 50001),
        ("slvmove-outside-slave-mode", 50001),
        ("unknown-command", 50002),
        ("argument-refused", 50002),
    ]


def test_the_findings_of_a_client_stand_together_the_gravest_first() -> None:
    def play(story: Story) -> None:
        first, second = story.client(), story.client(50002, host="192.168.0.11")
        first.open()
        first.execute(40, "CurJnt", code=_BUSY)
        first.execute(100, "CurrJnt", code=_NO_COMMAND)
        second.call(150, "Service_Start", text(",WDT=400"))
        second.call(155, "Robot_Move", ROBOT, i4(1), text("@E P1"), text(""))
        second.execute(160, "Motor", i4s(1, 0), code=0x8150101A)

    found = stage(play)
    assert [(each.rule, each.conversation.client.port) for each in found.findings] == [
        ("emergency-stop", 50002),
        ("type-not-checked", 50002),
        ("unknown-command", 50001),
        ("robot-busy", 50001),
    ]


def _two_problems(gap: float) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.execute(40, "CurrJnt", code=_NO_COMMAND)
        _stops_in_motion(client, 100 + gap)

    return play


def test_of_one_client_too_the_stop_comes_first() -> None:
    rules = [finding.rule for finding in stage(_two_problems(50)).findings]
    assert rules[:3] == ["set-point-gap", "underflow", "slvmove-outside-slave-mode"]
    assert "unknown-command" in rules[3:]


def test_what_kept_the_robot_from_moving_stands_above_a_harmless_refusal() -> None:
    def play(story: Story) -> None:
        other, client = story.client(50002, host="192.168.0.11"), story.client()
        other.open(5)
        other.execute(100, "CurrJnt", code=_NO_COMMAND)
        client.open(10)
        client.execute(200, "Motor", i4s(1, 0), code=0x8150101A)
        for talker, start in ((client, 300.0), (other, 320.0)):
            talker.close(start)

    assert [finding.rule for finding in stage(play).findings] == ["emergency-stop", "unknown-command"]
