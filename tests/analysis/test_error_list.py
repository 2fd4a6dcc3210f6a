"""The error that a client read from the controller is the cause of the refusal before it."""

from __future__ import annotations

import pytest

from bcapscope.analysis.rules import error_list_rules
from bcapscope.protocol.codec.variant import Variant
from tests.analysis.scenes import CONTROLLER, ROBOT, Diagnosed, Play, Story, Talker, stage
from tests.samples.calls import i4, mixed, text
from tests.samples.findings import sentence_of

_STOP, _ABANDONED, _UNDERFLOW, _OUTSIDE = 0x8150101A, 0x84201486, 0x84201482, 0x83500121
_LIMIT, _ACTIVE, _TOKEN, _UNLISTED = 0x84204051, 0x81501025, 0x83501028, 0x84999999


def _signed(code: int) -> int:
    return code - (1 << 32) if code & 0x80000000 else code


def _info(code: int, *more: Variant) -> Variant:
    return mixed(i4(_signed(code)), text("a message"), *more)


def _reads(client: Talker, ms: float, codes: tuple[int, ...]) -> float:
    """Read the list, newest error first, as DENSO's samples do; return when the next call is due."""
    execute = "Controller_Execute", CONTROLLER
    client.call(ms, *execute, text("GetCurErrorCount"), i4(0), result=i4(len(codes)))
    for index, code in enumerate(codes):
        ms += 5
        client.call(ms, *execute, text("GetCurErrorInfo"), i4(index), result=_info(code))
    return ms + 5


def _fails(code: int, listed: tuple[int, ...], *, clears_first: bool = False) -> Play:
    """Motion that ends with an error, and then the error list."""

    def play(story: Story) -> None:
        client = story.client()
        at = client.drive(20)
        client.point(at, 1.0, code)
        at += 20
        if clears_first:
            client.control(at - 10, "ClearError")
        client.close(_reads(client, at, listed))

    return play


def _causes(found: Diagnosed) -> list[tuple[str, str]]:
    causes = [
        "" if (n := each.consequence_of) is None else found.findings[n - 1].rule for each in found.findings
    ]
    return [(each.rule, cause) for each, cause in zip(found.findings, causes, strict=True)]


@pytest.mark.parametrize(
    ("code", "listed", "wanted"),
    [
        (_ABANDONED, (_ABANDONED, _STOP), [("emergency-stop", ""), ("controller-error", "emergency-stop")]),
        (_ABANDONED, (_STOP, _ABANDONED), [("emergency-stop", ""), ("controller-error", "emergency-stop")]),
        (_ABANDONED, (_STOP,), [("emergency-stop", ""), ("controller-error", "emergency-stop")]),
        (_ABANDONED, (_LIMIT,), [("over-limit", ""), ("controller-error", "over-limit")]),
        (_ABANDONED, (_TOKEN,), [("no-executable-token", ""), ("controller-error", "no-executable-token")]),
        (_ABANDONED, (_UNLISTED,), [("controller-error", ""), ("controller-error", "controller-error")]),
        (
            _ABANDONED,
            (_LIMIT, _STOP),
            [
                ("emergency-stop", ""),
                ("over-limit", "emergency-stop"),
                ("controller-error", "emergency-stop"),
            ],
        ),
        (
            _OUTSIDE,
            (_OUTSIDE, _STOP),
            [
                ("emergency-stop", ""),
                ("slave-mode-lost-unseen", "emergency-stop"),
                ("slvmove-outside-slave-mode", "emergency-stop"),
            ],
        ),
        (_UNDERFLOW, (_UNDERFLOW, _STOP), [("emergency-stop", ""), ("underflow", "emergency-stop")]),
        (_UNDERFLOW, (_STOP, _UNDERFLOW), [("underflow", "")]),
        (_UNDERFLOW, (_STOP,), [("underflow", "")]),
        (_ABANDONED, (_ABANDONED,), [("controller-error", "")]),
        (_ABANDONED, (_ABANDONED, _OUTSIDE, 0), [("controller-error", "")]),
    ],
)
def test_the_error_list_names_the_cause(
    code: int, listed: tuple[int, ...], wanted: list[tuple[str, str]]
) -> None:
    assert sorted(_causes(stage(_fails(code, listed)))) == sorted(wanted)
    assert _causes(stage(_fails(code, listed)))[0] == wanted[0]


def test_the_finding_says_when_the_error_was_read_and_what_it_explains() -> None:
    found = stage(_fails(_ABANDONED, (_ABANDONED, _STOP)))
    first = found.findings[0]
    sentence = sentence_of(first, found.seen)
    assert sentence.startswith(
        "With GetCurErrorInfo 31 at 0.240 s, your client read the error 0x8150101A, emergency stop is on. "
        "This error was probably active when slvMove 28 was sent at 0.210 s."
    )
    assert first.frames == (55, 56, 61, 62)
    assert "Release the stop" in str(first.advice)


def test_an_error_that_was_cleared_before_the_list_was_read_explains_nothing() -> None:
    assert stage(_fails(_ABANDONED, (_STOP,), clears_first=True)).of("emergency-stop") == []


def test_a_list_that_is_read_before_anything_failed_is_no_finding() -> None:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.control(_reads(client, 40, (_STOP, _LIMIT)), "ClearError")
        client.close(100)

    assert stage(play).findings == ()


def test_a_list_that_is_read_again_and_again_is_one_finding() -> None:
    def play(story: Story) -> None:
        client = story.client()
        at = client.drive(20)
        client.point(at, 1.0, _ABANDONED)
        for _ in range(5):
            at = _reads(client, at + 20, (_ABANDONED, _STOP))
        client.close(at + 10)

    (finding,) = stage(play).of("emergency-stop")
    assert finding.repetition is None


@pytest.mark.parametrize("tcp", [True, False])
def test_another_client_may_read_the_list(tcp: bool) -> None:
    def play(story: Story) -> None:
        watcher, client = story.client(50002, tcp=tcp), story.client()
        watcher.open(2)
        at = client.drive(20)
        client.point(at, 1.0, _ABANDONED)
        watcher.close(_reads(watcher, at + 5, (_ABANDONED, _STOP)))
        client.close(at + 100)

    found = stage(play)
    assert _causes(found) == [("emergency-stop", ""), ("controller-error", "emergency-stop")]
    assert found.findings[0].conversation.client.port == 50001


def test_the_variable_error_code_is_read_too() -> None:
    def play(story: Story) -> None:
        client = story.client()
        at = client.drive(20)
        client.point(at, 1.0, _ABANDONED)
        variable = "Controller_GetVariable", CONTROLLER, text("@ERROR_CODE"), text("")
        client.call(at + 10, *variable, result=i4(9))
        client.call(at + 15, "Variable_GetValue", i4(9), result=i4(_signed(_STOP)))
        client.call(at + 20, "Variable_Release", i4(9))
        client.close(at + 30)

    assert _causes(stage(play)) == [("emergency-stop", ""), ("controller-error", "emergency-stop")]


@pytest.mark.parametrize(
    ("listed", "wanted"),
    [
        (_STOP, [("emergency-stop", ""), ("error-not-cleared", "emergency-stop")]),
        (_UNDERFLOW, [("error-not-cleared", "")]),
    ],
)
def test_a_refusal_because_of_an_active_error_follows_only_from_a_state_that_lasts(
    listed: int, wanted: list[tuple[str, str]]
) -> None:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        client.call(40, "Robot_Move", ROBOT, i4(1), text("@E P1"), text(""), code=_ACTIVE)
        client.close(_reads(client, 50, (listed,)))

    assert _causes(stage(play)) == wanted


@pytest.mark.parametrize("result", [None, text("no array"), mixed(), mixed(text("5")), i4(0), i4(7)])
def test_a_reply_that_is_no_error_is_passed_over(result: Variant | None) -> None:
    def play(story: Story) -> None:
        client = story.client()
        at = client.drive(20)
        client.point(at, 1.0, _ABANDONED)
        client.call(at + 10, "Controller_Execute", CONTROLLER, text("GetCurErrorInfo"), i4(0), result=result)
        client.close(at + 20)

    assert _causes(stage(play)) == [("controller-error", "")]


def test_what_is_remembered_of_an_error_list_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(error_list_rules, "_MAX_CODES", 4)

    def play(story: Story) -> None:
        client = story.client()
        at = client.drive(20)
        client.point(at, 1.0, _ABANDONED)
        codes = tuple(0x83204071 + axis for axis in range(8)) + tuple(0x84204051 + axis for axis in range(8))
        client.close(_reads(client, at + 20, codes))

    repeated = [finding.repetition for finding in stage(play).findings if finding.rule == "beyond-range"]
    assert [each and each.count for each in repeated] == [4]
