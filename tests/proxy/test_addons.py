"""Addons: loading them, calling them, and what goes wrong in them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest

from bcapscope.proxy.addons import SLOW_HOOK_NS, AddonClient, AddonRunner, PassingMessage, load_addons
from bcapscope.proxy.script_protocol import (
    ClientConnected,
    ClientGone,
    FinishScripts,
    MessageShown,
    ScriptAnswer,
    ScriptError,
    ScriptOrder,
)
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import MAX_CONVERSATIONS
from bcapscope.traffic.observation import Transport
from tests.faults.traffic import CLIENT, SERVER, reply, request

WHO = AddonClient(1, CLIENT, SERVER, Transport.UDP)
CONNECTED = ClientConnected(1, (CLIENT, SERVER), Transport.UDP)


def message(raw: bytes = b"") -> MessageShown:
    """Make a request on its way."""
    return MessageShown(1, True, raw or request(7), 0, 0)


def obey(addons: AddonRunner, *orders: ScriptOrder) -> tuple[ScriptAnswer, list[str]]:
    """Have orders obeyed by addons that know a client; return the last answer, and all notices."""
    answers = [addons.execute(order) for order in (CONNECTED, *orders)]
    return answers[-1], [str(notice.message) for answer in answers for notice in answer.notices]


@pytest.fixture
def script(tmp_path: Path) -> Callable[[str], str]:
    """Write scripts."""

    def write(text: str) -> str:
        path = tmp_path / "mine.py"
        path.write_text(text, "utf-8")
        return str(path)

    return write


def test_an_error_of_several_lines_is_reported_by_its_first(script: Callable[[str], str]) -> None:
    with pytest.raises(ScriptError, match=r"ValueError: first \(mine\.py line 1\)"):
        load_addons(script("raise ValueError('first\\nsecond')"))


def test_each_class_with_a_hook_is_made(script: Callable[[str], str]) -> None:
    path = script(
        "from dataclasses import dataclass\n"
        "from pathlib import Path\n"
        "class First:\n    def request(self, message): message.drop()\n"
        "@dataclass\nclass Second:\n    count: int = 0\n    def done(self): pass\n"
        "class Helper: pass\n"
        "class _Base:\n    def reply(self, message): pass\n"
    )
    assert [type(addon).__name__ for addon in load_addons(path)] == ["First", "Second"]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("x = 1", "has no class with a method request, reply, settled, connected, gone or done"),
        ("def (", "invalid syntax|line 1"),
        ("import nothing_like_it", r"No module named 'nothing_like_it' \(mine.py line 1\)"),
        ("1 / 0", r"division by zero \(mine.py line 1\)"),
        ("import sys; sys.exit(5)", "SystemExit: 5"),
        ("open('settings.none')", r"^\S+: FileNotFoundError.*'settings.none' \(mine.py line 1\)"),
        ("class A:\n  async def done(self): pass", r"A.done is async, but the proxy does not await it"),
        ("import asyncio; raise asyncio.CancelledError", r"CancelledError \(mine.py line 1\)"),
        ("raise ValueError('one\\ntwo')", r"ValueError: one \(mine.py line 1\)"),
        ("class A:\n  def __init__(self, x): pass\n  def done(self): pass", "missing 1 required positional"),
    ],
)
def test_a_script_that_cannot_be_used_is_told(script: Callable[[str], str], text: str, reason: str) -> None:
    with pytest.raises(ScriptError, match=reason):
        load_addons(script(text))


def test_a_script_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(ScriptError, match="cannot be read: No such file"):
        load_addons(str(tmp_path / "none.py"))
    with pytest.raises(ScriptError, match="is not a Python file"):
        load_addons(str(tmp_path / "none.txt"))


def test_a_hook_sees_what_there_is_to_know() -> None:
    seen: list[PassingMessage] = []

    class Looker:
        def request(self, message: PassingMessage) -> None:
            seen.append(message)

    obey(AddonRunner([Looker()]), message(), message(b"garbage"))
    first, second = seen
    assert (first.client, first.function, first.command) == (WHO, "Robot_Execute", "slvMove")
    assert first.values == [1, "slvMove", (1.0, 2.0, 3.0)]
    assert (second.frame, second.function, second.command, second.values) == (None, None, None, [])


class Broken:
    """Goes wrong in every way."""

    def request(self, message: PassingMessage) -> None:
        raise SystemExit

    def connected(self, client: AddonClient) -> None:
        raise RuntimeError("[/red]\x1b[2J")

    def done(self) -> None:
        raise KeyError("x")


class Careless:
    """Puts something else in place of the bytes."""

    def request(self, message: PassingMessage) -> None:
        message.data = "text"  # type: ignore[assignment]  # as users do


def test_what_goes_wrong_is_told_once_and_stops_nothing() -> None:
    addons = AddonRunner([Broken(), Careless()], clock=lambda: 0)
    unchanged, notices = obey(addons, message(), message(), message())
    assert unchanged.data is None
    answer = addons.execute(ClientGone(1))
    assert answer.notices == ()
    answer = addons.execute(FinishScripts())
    notices += [str(notice.message) for notice in answer.notices]
    assert [text.split(" (test_addons")[0] for text in notices] == [
        "Broken.connected: RuntimeError: [/red]\x1b[2J",
        "Broken.request: SystemExit",
        "request: data must be bytes; the message passes unchanged (reported once)",
        "Broken.done: KeyError: 'x'",
    ]
    assert answer.errors == 8


def test_where_it_went_wrong_is_looked_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken:
        def connected(self, client: AddonClient) -> None:
            raise ValueError

    looked: list[str] = []

    def where(error: BaseException) -> str:
        looked.append("here")
        return "here"

    monkeypatch.setattr("bcapscope.proxy.addons._where", where)
    answer, _ = obey(AddonRunner([Broken()]), CONNECTED, CONNECTED)
    assert (len(looked), answer.errors) == (1, 3)


@pytest.mark.parametrize("kind", [SystemExit, asyncio.CancelledError, GeneratorExit, KeyboardInterrupt])
def test_nothing_that_can_be_raised_ends_the_relay(kind: type[BaseException]) -> None:
    class Broken:
        def done(self) -> None:
            raise kind

    answer, notices = obey(AddonRunner([Broken()], clock=lambda: 0), FinishScripts())
    assert answer.errors == len(notices) == 1
    assert kind.__name__ in notices[0]


def test_answers_are_given_in_one_way_only() -> None:
    class Careless:
        def request(self, message: PassingMessage) -> None:
            message.answers = (-1,)  # type: ignore[misc]  # as users do

    answer, _ = obey(AddonRunner([Careless()]), message())
    assert (answer.results, answer.errors) == ((), 1)


def test_a_slow_hook_is_told_once() -> None:
    class Slow:
        def request(self, message: PassingMessage) -> None:
            pass

    times = iter([0, SLOW_HOOK_NS + 500_000, 10 * SLOW_HOOK_NS, 12 * SLOW_HOOK_NS])
    answer, notices = obey(AddonRunner([Slow()], clock=lambda: next(times)), message(), message())
    assert notices == ["Slow.request delayed messages by 2.5 ms (reported once)"]
    assert answer.errors == 0


@pytest.mark.parametrize(("took", "is_slow"), [(2_000_000, False), (2_000_001, True)])
def test_a_hook_is_slow_after_2_ms(took: int, is_slow: bool) -> None:
    class Hook:
        def connected(self, client: AddonClient) -> None:
            pass

    times = iter([1000, 1000 + took])
    _, notices = obey(AddonRunner([Hook()], clock=lambda: next(times)))
    assert len(notices) == is_slow


def test_one_answer_has_at_most_32_messages_for_the_user() -> None:
    answer, notices = obey(AddonRunner([Broken() for _ in range(33)], clock=lambda: 0))
    assert (len(notices), answer.errors) == (32, 33)


def test_later_addons_do_not_see_a_dropped_message() -> None:
    seen: list[PassingMessage] = []

    class Dropper:
        def request(self, message: PassingMessage) -> None:
            message.drop()

    class Looker:
        def request(self, message: PassingMessage) -> None:
            seen.append(message)

    answer, _ = obey(AddonRunner([Dropper(), Looker()]), message())
    assert (answer.dropped, seen) == (True, [])


def test_the_calls_of_a_client_settle_before_it_is_gone() -> None:
    events: list[str] = []

    class Order:
        def settled(self, call: Call) -> None:
            events.append(f"settled {call.request.number}")

        def gone(self, client: AddonClient) -> None:
            events.append(f"gone {client.number}")

    obey(AddonRunner([Order()]), message(), ClientGone(1))
    assert events == ["settled 1", "gone 1"]


def test_clients_that_are_gone_do_not_displace_the_requests_of_a_silent_client() -> None:
    functions: list[str | None] = []

    class Functions:
        def reply(self, message: PassingMessage) -> None:
            functions.append(message.function)

    others: list[ScriptOrder] = []
    for number in range(2, 2 + MAX_CONVERSATIONS):
        connected = ClientConnected(number, (CLIENT, SERVER), Transport.UDP)
        others += connected, MessageShown(number, True, request(7), 0, 0), ClientGone(number)
    obey(AddonRunner([Functions()]), message(), *others, MessageShown(1, False, reply(7), 0, 0))
    assert functions == ["Robot_Execute"]


def test_the_frames_of_a_settled_call_are_numbered_from_1() -> None:
    numbers: list[tuple[int, int]] = []

    class Numbers:
        def settled(self, call: Call) -> None:
            assert call.reply is not None
            numbers.append((call.request.number, call.reply.number))

    obey(
        AddonRunner([Numbers()]), message(request(7)), MessageShown(1, False, reply(7), 0, 0), FinishScripts()
    )
    assert numbers == [(1, 2)]
