"""Texts that would do something, wherever one from outside is shown: shown they are, and nothing happens."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest
from rich.segment import Segment
from textual.color import Color
from textual.events import Paste
from textual.pilot import Pilot
from textual.widgets import Input

from bcapscope.capture.socket_recording import SocketRecording
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.proxy.control_messages import ClientStatus, FaultStatus, HeldStatus
from bcapscope.render.escape import printable
from bcapscope.traffic.observation import Direction, Transport
from bcapscope.tui.app import BcapApp, ScreenEntry
from bcapscope.tui.proxy_display import edited_message, proposed_edit
from bcapscope.tui.screens.proxy_screen import ProxyScreen, ProxyState
from bcapscope.tui.screens.traffic_screen import TrafficScreen
from bcapscope.tui.terminal import ControlCharFilter
from bcapscope.tui.tester.call_lists import HistoryLines
from bcapscope.tui.tester.form_widgets import ChoiceRow
from bcapscope.tui.traffic_processes.process_messages import ReadJob
from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed
from tests.client.server import udp_server
from tests.tui.pilot import drive, make, shown, until
from tests.tui.proxy_panel.proxy_figures import figures
from tests.tui.showing import read
from tests.tui.showing import screen as traffic_screen
from tests.tui.tester import answered, connected, finish, focus, make_tester, write

MARKUP = "[/foo][red]x[@click=app.quit]"
ESCAPES = "\x1b[2J\x1b]52;c;eA==\x07\x9b31m\x00\r\n"
BIDI = "\u202egnp\u2066\u200f\u2028"
SURROGATES = "a\ud800b\udfff"
TEXTS = {"short": MARKUP + ESCAPES + BIDI + SURROGATES, "long": "[bold]" + "x" * 10_000 + "[/foo]"}
CLIENT, SERVER = ("10.0.0.2", 50001), ("10.0.0.1", 5007)
TIME = 1_700_000_000_000_000_000
EXECUTE, INVALID = 64, 0x80070057

pytestmark = pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS.keys())


async def look(pilot: Pilot[None]) -> None:
    """Let all be drawn, and look at every character."""
    await pilot.pause()
    assert isinstance(pilot.app, BcapApp)
    drawn = shown(pilot.app)
    assert [char for char in drawn if not char.isprintable() and char not in "\n\u3000"] == []


async def picture(pilot: Pilot[None]) -> None:
    """Look, and at the picture of it as well."""
    await look(pilot)
    assert ElementTree.fromstring(pilot.app.export_screenshot()).tag.endswith("svg")


def capture(path: Path, text: str) -> None:
    """Write a capture in which the text is everywhere that a peer can put it."""
    string = Variant(VT.BSTR, text)
    with path.open("wb") as file:
        recording = SocketRecording(file)

        def say(
            serial: int, code: int, values: list[Variant], answer: list[Variant], result: int = 0
        ) -> None:
            at = TIME + serial * 10**7
            recording.write_segment(CLIENT, SERVER, encode_frame(serial, 0, code, values), at)
            recording.write_segment(SERVER, CLIENT, encode_frame(serial, 0, result, answer), at + 10**6)

        say(1, 1, [string], [])
        say(2, 3, [string, string, string, string], [Variant(VT.I4, 1)])
        say(3, 7, [Variant(VT.I4, 1), string, string], [Variant(VT.I4, 2)])
        say(4, EXECUTE, [Variant(VT.I4, 2), string, string], [string], INVALID)
        say(5, EXECUTE, [Variant(VT.I4, 2), string, Variant.array(VT.BSTR, (text, text))], [string])
        recording.write_segment(
            CLIENT, SERVER, b"\x01" + text.encode("utf-16-le", "surrogatepass"), TIME + 10**9
        )


def test_traffic(text: str, tmp_path: Path) -> None:
    path = tmp_path / "hostile.pcapng"
    capture(path, text)
    feed = TrafficFeed(ReadJob(path=str(path)))
    app = make(ScreenEntry("traffic", "f3", "traffic", lambda: TrafficScreen(feed, text)))

    async def act(pilot: Pilot[None]) -> None:
        await read(pilot, feed)
        here = traffic_screen(pilot)
        app.settings.captures.insert(0, text)
        for number in (3, 8, 9, 10, 11):
            here.go_to_frame(number)
            await look(pilot)
        for keys in (
            ("enter", "a", "end"),
            ("tab", "end", "home", "escape"),
            ("K", "escape"),
            ("H", "escape"),
        ):
            await pilot.press(*keys)
            await look(pilot)
        for key in "12345":
            await pilot.press(key, "home", "space", "end", "right")
            await picture(pilot)
        await pilot.press("1", "slash")
        app.post_message(Paste(text))
        await look(pilot)
        await pilot.press("escape", "escape", "f1")
        await look(pilot)
        await pilot.press("escape", "ctrl+p", *"open")
        await look(pilot)
        await pilot.press("escape", "e")
        await pilot.pause()
        app.screen.query_one("#prompt-input", Input).value = text
        await look(pilot)
        await pilot.press("enter")
        await look(pilot)
        assert here.frames.marks
        feed.report_source_problem(text)
        await pilot.pause()
        here._open_capture(text)
        app.show_message(text, "error")
        await picture(pilot)
        await pilot.press("s")
        app.screen.query_one("#prompt-input", Input).value = str(tmp_path / "notes.pcapng")
        await pilot.press("enter")
        await until(pilot, lambda: any("Saved" in note.message for note in app._notifications))

    try:
        drive(app, act, (132, 40))
    finally:
        feed.close()


class _FixedStateScreen(ProxyScreen):
    """Shows the same state of a proxy all the time."""

    def __init__(self, state: ProxyState, route: str) -> None:
        super().__init__("nowhere", route)
        self._fixed_state = state

    def read_state(self) -> ProxyState:
        return self._fixed_state


def hostile_state(text: str) -> ProxyState:
    """Return a state of a proxy with the text in every place for text."""
    string = Variant(VT.BSTR, text)
    message = encode_frame(1, 0, EXECUTE, [Variant(VT.I4, 1), string, string]).hex()
    address = "10.0.0.2:50001"
    ends = (address, "10.0.0.1:5007", Transport.TCP, Direction.REQUEST)
    return ProxyState(
        [ClientStatus(1, text, text, text, text, 1.0, 1, None, 0, None)],
        [FaultStatus(text, True, 1, text)],
        [
            HeldStatus(1, *ends, EXECUTE, text, text, 1.0, 59.0, message),
            HeldStatus(
                2, *ends, None, None, None, 1.0, 59.0, text.encode("utf-16-le", "surrogatepass").hex()
            ),
        ],
        figures(injected={text: 1}, guard=True, intercept=text, held_so_far=1, recording=text),
    )


def test_proxy(text: str) -> None:
    place = _FixedStateScreen(hostile_state(text), text)
    app = make(ScreenEntry("proxy", "f2", "proxy", lambda: place))

    async def act(pilot: Pilot[None]) -> None:
        await until(pilot, lambda: place.held.items)
        place.add_output(text)
        for key in "1234":
            await pilot.press(key)
            await picture(pilot)
        await pilot.press("3", "e")
        proposed = place.query_one("#change", Input).value
        assert proposed.isprintable()
        await look(pilot)
        await pilot.press("escape", "down", "b")
        await look(pilot)
        await pilot.press("escape", "i")
        await look(pilot)
        await pilot.press("escape", "a")
        app.post_message(Paste(text))
        await look(pilot)
        place.show_end(text)
        await look(pilot)

    drive(app, act)


def test_what_is_proposed_for_a_held_message_is_read_back_as_it_was(text: str) -> None:
    flow = hostile_state("x").held[0].flow
    message = encode_frame(1, 0, EXECUTE, [Variant(VT.I4, 1), Variant(VT.BSTR, text)])
    proposed = proposed_edit(message, len(message) - 10)
    assert proposed.isprintable()
    with pytest.raises(ValueError, match="changes nothing"):
        edited_message(message, flow, proposed)


def test_tester(text: str, tmp_path: Path) -> None:
    answers = {
        "Robot_Execute": (0, [Variant(VT.BSTR, text)]),
        "Variable_GetValue": (INVALID, [Variant(VT.BSTR, text)]),
    }
    with udp_server(lambda peer: peer.answers.update(answers)) as server:
        app = make_tester(tmp_path, "127.0.0.1", server.port)

        async def act(pilot: Pilot[None]) -> None:
            here = await connected(pilot)
            await focus(pilot, "#robot-forms .command")
            await write(pilot, "slvGetMode")
            await pilot.press("enter")
            await answered(pilot, "#execute ResultView", printable(text)[:20])
            await look(pilot)
            for name in ("received", "saved", "history"):
                here.query_one("#view", ChoiceRow).chosen = name
                await look(pilot)
            here.query_one(HistoryLines).focus()
            await pilot.press("end")
            await picture(pilot)
            await focus(pilot, "#robot-forms .command")
            app.post_message(Paste(text))
            await look(pilot)
            await pilot.press("f1")
            await look(pilot)
            await pilot.press("escape")
            await finish(pilot)

        drive(app, act, (120, 40))


def test_the_guard_before_the_terminal_keeps_every_column(text: str) -> None:
    guard: Callable[[list[Segment], Color], list[Segment]] = ControlCharFilter().apply
    line = [Segment("名前 "), Segment(text), Segment("\u3000")]
    (first, middle, last) = guard(line, Color(0, 0, 0))
    assert first.text == "名前 "
    assert middle.text.isprintable()
    assert last.text == "\u3000"
    assert sum(segment.cell_length for segment in guard(line, Color(0, 0, 0))) == sum(
        segment.cell_length for segment in line
    )
