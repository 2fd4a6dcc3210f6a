"""The screen of a proxy before a simulator: both are processes, as for the user."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest
from textual.pilot import Pilot
from textual.widgets import Input, Static

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.client import RetryPolicies, open_session, over_tcp, over_udp
from bcapscope.errors import BcapError
from bcapscope.live.child_process import ChildProcess
from bcapscope.messages import Language
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.requester import RetryPolicy
from bcapscope.proxy.control_messages import ClientStatus, FaultStatus, HeldStatus, RelayDelays
from bcapscope.traffic.observation import Direction, Transport
from bcapscope.tui.app import BcapApp, ScreenEntry
from bcapscope.tui.screens.proxy_screen import ProxyScreen, ProxyState
from bcapscope.tui.screens.traffic_screen import TrafficScreen
from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed, watcher_job
from bcapscope.tui.widgets.bars import ViewBar
from tests.tui.pilot import drive, make, picture, shown, until
from tests.tui.proxy_panel.proxy_figures import figures
from tests.tui.showing import screen as traffic_screen

PICTURES = Path(__file__).parent.parent.parent.parent / "docs" / "pictures"
ONCE = RetryPolicy(400_000_000, 0)
PATIENT = RetryPolicy(20_000_000_000, 0)
HOSTILE = "[/foo]\x1b[31m\u202e"


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[int, Path]]:
    """Give the port of a simulator, and its recording."""
    record = tmp_path_factory.mktemp("simulated") / "seen.pcapng"
    child = ChildProcess("sim", "--port", "0", "--record", str(record), "--quiet")
    try:
        yield int(child.listen_addresses[0].rpartition(":")[2]), record
    finally:
        child.terminate()


@contextmanager
def proxied(folder: Path, to: int, *words: str) -> Iterator[tuple[BcapApp, ProxyScreen, ChildProcess, int]]:
    """Make the application with a proxy and its traffic."""
    job = watcher_job(folder, folder / "proxy.pcapng")
    control = ("--control", "127.0.0.1:0")
    spec = ("--listen", "127.0.0.1:0", "--to", f"127.0.0.1:{to}", "--record", job.path, "--quiet")
    publish = ("--publish", msgspec.json.encode(job).decode())
    child = ChildProcess("proxy", *spec, *control, *publish, *words)
    try:
        port = int(child.listen_addresses[0].partition(" > ")[0].rpartition(":")[2])
        feed = TrafficFeed(job, child.hand_over_stdout())
        place = ProxyScreen(child.control_address, child.listen_addresses[0], feed, child)
        try:
            spots = [
                ScreenEntry("proxy", "f2", "proxy", lambda: place),
                ScreenEntry("traffic", "f3", "traffic", lambda: TrafficScreen(feed, "proxy")),
            ]
            yield make(*spots, settings=folder / "screen.yaml"), place, child, port
        finally:
            feed.close()
    finally:
        child.terminate()


async def ask(port: int, name: str, *values: object, pace: RetryPolicy = ONCE, tcp: bool = False) -> str:
    """Call a function; give "answered", or why it was not."""
    opener = (over_tcp if tcp else over_udp)("127.0.0.1", port)
    try:
        async with open_session(opener, retry_policies=RetryPolicies(pace, pace, pace)) as session:
            await session.invoke(name, *values)
    except BcapError as error:
        return type(error).__name__
    return "answered"


def text_of(place: ProxyScreen, selector: str) -> str:
    """Return what stands in a part of the screen."""
    return str(place.query_one(selector, Static).content)


async def type_in(pilot: Pilot[None], text: str) -> None:
    """Put a text in place of what stands in the field that has the focus."""
    field = pilot.app.focused
    assert isinstance(field, Input), field
    field.value = text
    await pilot.pause()


def test_a_rule_that_is_switched_off_lets_pass_and_clients_appear(
    simulated: tuple[int, Path], tmp_path: Path
) -> None:
    with proxied(tmp_path, simulated[0], "--fault", "drop request name all") as (app, place, _, port):

        async def act(pilot: Pilot[None]) -> None:
            assert await ask(port, "Service_Start", "") == "CallTimeout"
            await until(pilot, lambda: place.clients.items)
            assert place.clients.items[0].transport == "udp"
            await pilot.press("2")
            await until(pilot, lambda: place.rules.items and place.rules.items[0].injected == 1)
            await pilot.press("space")
            await until(pilot, lambda: not place.rules.items[0].on)
            assert await ask(port, "Service_Start", "") == "answered"
            await pilot.press("space")
            await until(pilot, lambda: place.rules.items[0].on)
            assert await ask(port, "Service_Start", "") == "CallTimeout"
            await until(pilot, lambda: len(place.clients.items) == 3)
            await pilot.press("f3")
            await until(pilot, lambda: traffic_screen(pilot).frames.count == 6)
            assert "# all: dropped" in shown(app)

        drive(app, act)


def test_a_rule_is_typed_and_taken_away(simulated: tuple[int, Path], tmp_path: Path) -> None:
    with proxied(tmp_path, simulated[0]) as (app, place, _, port):

        async def act(pilot: Pilot[None]) -> None:
            await pilot.press("a")
            await type_in(pilot, "los=5%")
            assert "did you mean 'loss'" in text_of(place, "#fault-error")
            await pilot.press("enter")
            await type_in(pilot, "answer=E_FAIL if function == Service_Start")
            assert not place.query_one("#fault-error").display
            await pilot.press("enter")
            await until(pilot, lambda: place.rules.items)
            assert await ask(port, "Service_Start", "") == "ControllerError"
            await pilot.press("d")
            await until(pilot, lambda: not place.rules.items)
            assert await ask(port, "Service_Start", "") == "answered"

        drive(app, act)


def test_a_message_that_waits_is_edited_and_arrives_edited(
    simulated: tuple[int, Path], tmp_path: Path
) -> None:
    with proxied(tmp_path, simulated[0], "--intercept", "function == Robot_Execute and kind == request") as (
        app,
        place,
        _,
        port,
    ):

        async def act(pilot: Pilot[None]) -> None:
            mode = Variant(VT.I4, 258)
            calls = [
                asyncio.create_task(ask(port, "Robot_Execute", 77, name, mode, pace=PATIENT))
                for name in ("slvChangeMode", HOSTILE)
            ]
            await until(pilot, lambda: len(place.held.items) == 2)
            await pilot.press("3", "home")
            if place.held.items[0].command != "slvChangeMode":
                await pilot.press("down")
            await pilot.pause()
            assert "slvChangeMode" in shown(app)
            assert "\x1b" not in shown(app)
            await pilot.press("e")
            await pilot.pause()
            assert place.query_one("#change", Input).value == "set arg[2]=258"
            await type_in(pilot, "set arg[7]=1")
            assert "changes nothing" in text_of(place, "#change-error")
            await type_in(pilot, "set arg[2]=0")
            await pilot.press("enter")
            await until(pilot, lambda: len(place.held.items) == 1)
            await pilot.press("f")
            await until(pilot, lambda: not place.held.items)
            assert await asyncio.gather(*calls) == ["ControllerError"] * 2  # there is no robot 77

        drive(app, act)
    arrived = [
        tuple(argument.variant.value for argument in frame.arguments)
        for frame in requests(simulated[1])
        if frame.code == 64
    ]
    assert sorted(arrived, key=str) == sorted([(77, "slvChangeMode", 0), (77, HOSTILE, 258)], key=str)


def test_tcp_clients_are_seen_and_their_messages_held_edited_and_dropped(
    simulated: tuple[int, Path], tmp_path: Path
) -> None:
    wanted = "command == slvChangeMode and kind == request"
    with proxied(tmp_path, simulated[0], "--intercept", wanted) as (app, place, _, port):

        async def act(pilot: Pilot[None]) -> None:
            mode = Variant(VT.I4, 258)
            pair = (78, "slvChangeMode", mode), (79, "slvChangeMode", mode)
            edited = asyncio.create_task(ask(port, "Robot_Execute", *pair[0], pace=PATIENT, tcp=True))
            await until(pilot, lambda: len(place.held.items) == 1)
            brief = RetryPolicy(3_000_000_000, 0)
            dropped = asyncio.create_task(ask(port, "Robot_Execute", *pair[1], pace=brief, tcp=True))
            await until(pilot, lambda: len(place.held.items) == 2)
            await until(pilot, lambda: [one.transport for one in place.clients.items] == ["tcp", "tcp"])
            await pilot.press("3", "home", "e")
            await pilot.pause()
            await type_in(pilot, "set arg[2]=1")
            await pilot.press("enter")
            await until(pilot, lambda: len(place.held.items) == 1)
            await pilot.press("x")
            await until(pilot, lambda: not place.held.items)
            assert await edited == "ControllerError"
            await until(pilot, lambda: "TCP bytes: up " in text_of(place, "#summary"))
            assert await dropped == "CallTimeout"
            await pilot.press("1")
            await until(pilot, lambda: not place.clients.items)  # they have hung up
            await pilot.press("f3")
            await until(
                pilot, lambda: "tcp" in str(traffic_screen(pilot).query_one("#about", Static).content)
            )

        drive(app, act, (160, 40))
    arrived = [
        tuple(argument.variant.value for argument in frame.arguments)
        for frame in requests(simulated[1])
        if frame.code == 64 and frame.arguments[0].variant.value in (78, 79)
    ]
    assert (78, "slvChangeMode", 1) in arrived
    assert not {258} & {mode for _, _, mode in arrived}  # neither as it came nor what was dropped


def requests(path: Path) -> list[Frame]:
    """Return the requests in a recording."""
    with open_capture(path) as capture:
        return [
            seen.item
            for seen in PacketDecoder().decode(capture)
            if seen.flow.direction is Direction.REQUEST and isinstance(seen.item, Frame)
        ]


def test_a_message_is_dropped_and_what_is_held_is_chosen(simulated: tuple[int, Path], tmp_path: Path) -> None:
    with proxied(tmp_path, simulated[0]) as (app, place, _, port):

        async def act(pilot: Pilot[None]) -> None:
            await pilot.press("i")
            await pilot.pause()
            await type_in(pilot, "function == Service_Start")
            await pilot.press("enter")
            await until(pilot, lambda: "Service_Start" in text_of(place, "#intercepts"))
            call = asyncio.create_task(ask(port, "Service_Start", "", pace=RetryPolicy(2_000_000_000, 0)))
            await until(pilot, lambda: place.held.items)
            assert "· held 1" in shown(app)
            await pilot.press("x")
            await until(pilot, lambda: not place.held.items)
            assert await call == "CallTimeout"

        drive(app, act)


def test_a_relay_that_is_killed_is_told_in_one_sentence(simulated: tuple[int, Path], tmp_path: Path) -> None:
    with proxied(tmp_path, simulated[0]) as (app, place, child, port):

        async def act(pilot: Pilot[None]) -> None:
            await until(pilot, lambda: "p99.9" in text_of(place, "#summary"))
            assert await ask(port, "Service_Start", "") == "answered"
            os.kill(child.pid, signal.SIGKILL)
            await until(pilot, lambda: "The proxy ended: it was killed" in text_of(place, "#summary"))
            assert "○ 127.0.0.1" in shown(app)
            await pilot.press("f3")
            await until(pilot, lambda: "The proxy ended: it was killed" in states(pilot))
            assert "live" not in states(pilot)
            await until(pilot, lambda: traffic_screen(pilot).feed.progress.ended)
            assert traffic_screen(pilot).frames.count == 4
            await pilot.press("f2", "2", "a")
            await type_in(pilot, "loss=5%")
            await pilot.press("enter", "1", "4", "ctrl+q")

        drive(app, act, (160, 40))


def states(pilot: Pilot[None]) -> str:
    """Return what is said of the traffic above its lists, where there is room for all of it."""
    return traffic_screen(pilot).query_one(ViewBar)._states[0]


class FixedStateScreen(ProxyScreen):
    """Shows the same state of a proxy all the time."""

    def __init__(self, state: ProxyState) -> None:
        super().__init__("nowhere", "127.0.0.1:5008 > 192.168.0.1:5007")
        self._fixed_state = state

    def read_state(self) -> ProxyState:
        return self._fixed_state


def proxy_state(slow: int = 0) -> ProxyState:
    """Return a made-up state of a proxy with four clients, two rules and two held messages."""
    message = encode_frame(
        9, 0, 64, [Variant(VT.I4, 2), Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I4, 258)]
    )
    hostile = encode_frame(10, 0, 64, [Variant(VT.I4, 2), Variant(VT.BSTR, HOSTILE), Variant(VT.EMPTY, None)])
    ends = ("10.0.0.2:50001", "192.168.0.1:5007", Transport.UDP, Direction.REQUEST)
    return ProxyState(
        [
            ClientStatus(
                1, "10.0.0.2:50001", "192.168.0.1:5007", "udp", "open", 75.0, 9000, 0.008, 8990, 0.009
            ),
            ClientStatus(2, "10.0.0.3:40001", "192.168.0.1:5007", "tcp", "connecting", 1.0, 0, None, 0, None),
            ClientStatus(3, "10.0.0.4:40002", "192.168.0.1:5007", "udp", "open", 4000.0, 12, 0.5, 10, 7.5),
            ClientStatus(4, "10.0.0.5:40003", "192.168.0.1:5007", "udp", "open", 2.0, 3, 0.5, 0, None),
        ],
        [
            FaultStatus("lossy", True, 123, "drop name lossy 5%"),
            FaultStatus(HOSTILE, False, 0, f"delay=3ms±1ms if command == {HOSTILE!r}"),
        ],
        [
            HeldStatus(4, *ends, 64, "Robot_Execute", "slvChangeMode", 3.25, 56.75, message.hex()),
            HeldStatus(5, *ends, 64, "Robot_Execute", HOSTILE, 2.0, 58.0, hostile.hex()),
        ],
        figures(
            injected={"lossy": 123},
            refused=7,
            guard=True,
            intercept="function == Robot_Execute",
            held_so_far=5,
            came_up=9012,
            left_up=8890,
            came_down=9000,
            left_down=9000,
            lost=slow,
            delays_ns=RelayDelays(
                75_000,
                120_000,
                210_000,
                2_400_000 if slow else 900_000,
                80_000,
                130_000,
                220_000,
                700_000,
                slow,
            ),
        ),
    )


@pytest.mark.parametrize("key", ["1", "2", "3", "4"])
@pytest.mark.parametrize("language", list(Language))
def test_every_list_can_be_shown_in_every_language_at_80_columns(key: str, language: Language) -> None:
    place = FixedStateScreen(proxy_state(slow=3))
    app = make(ScreenEntry("proxy", "f2", "proxy", lambda: place), language=language)

    async def act(pilot: Pilot[None]) -> None:
        await until(pilot, lambda: place.held.items)
        await pilot.press(key)
        await pilot.pause()
        lines = shown(app).splitlines()
        assert "2.4 ms" in "".join(lines)
        assert "\x1b" not in "".join(lines)
        if key == "2":
            assert "[/foo]" in "".join(lines)
        await pilot.press("f1")
        await pilot.pause()
        assert "loss=5%" in shown(app)

    drive(app, act, (80, 24))


def test_how_the_controller_does_is_told_for_each_client() -> None:
    place = FixedStateScreen(proxy_state())
    app = make(ScreenEntry("proxy", "f2", "proxy", lambda: place))

    async def act(pilot: Pilot[None]) -> None:
        await until(pilot, lambda: place.clients.items)
        found = [line.split("  ")[-1].strip() for line in shown(app).splitlines() if " 10.0.0." in line]
        assert found == ["answers", "connecting", "silent 8 s", "unanswered"]

    drive(app, act, (80, 24))


def test_picture(request: pytest.FixtureRequest) -> None:
    place, made = FixedStateScreen(proxy_state()), []
    app = make(ScreenEntry("proxy", "f2", "proxy", lambda: place))

    async def act(pilot: Pilot[None]) -> None:
        await until(pilot, lambda: place.held.items)
        await pilot.press("3", "e")
        await until(pilot, lambda: place.query_one("#change", Input).value)
        made.append(picture(app))

    drive(app, act, (110, 32))
    path = PICTURES / "proxy.svg"
    if request.config.getoption("--golden-write"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(made[0])
    assert made[0].decode() == path.read_text(), "look at the picture that --golden-write makes"
