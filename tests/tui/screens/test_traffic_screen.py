"""Traffic, key by key."""

from __future__ import annotations

import gzip
import shutil
from pathlib import Path

import pytest
from textual.color import Color
from textual.pilot import Pilot
from textual.widgets import Input, Static

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.pcapng_writer import PcapngWriter
from bcapscope.messages import Language
from bcapscope.tui.settings import read_settings
from bcapscope.tui.widgets.bars import ViewBar
from tests.cli.run import CAPTURES, run
from tests.tui.pilot import drive, until
from tests.tui.pilot import shown as drawn
from tests.tui.showing import about, act_on, read, screen, shown

SESSION, STORY = CAPTURES / "slave-session.pcapng", CAPTURES / "retry-story.pcapng"


def note(pilot: Pilot[None]) -> str:
    """Return the last message that was shown."""
    return list(pilot.app._notifications)[-1].message


def test_frames_calls_findings_slave_mode_statistics() -> None:
    async def act(pilot: Pilot[None]) -> None:
        text = drawn(pilot.app)  # type: ignore[arg-type]  # the only app there is
        assert "1 Frames 518" in text
        assert "Service_Start" in text
        assert "01 2e 00 00 00 01 00 01" in text
        for key, word in (
            ("2", "ms  frames 1 > 2"),
            ("3", "type-not-checked"),
            ("4", "Slave-mode session 1"),
            ("5", "by 192.168.0.10:50001"),
        ):
            await pilot.press(key)
            await until(pilot, lambda word=word: word in drawn(pilot.app))  # type: ignore[misc, arg-type]
        await pilot.click("#views", offset=(3, 0))
        assert screen(pilot).view == "frames"

    act_on(SESSION, act, (160, 48))


@pytest.mark.parametrize("view", ["frames", "calls"])
def test_the_time_since_the_line_above_does_not_depend_on_what_was_drawn_before(view: str) -> None:
    async def act(pilot: Pilot[None]) -> None:
        here = screen(pilot)
        here.action_view(view)
        await pilot.press("t")
        lines = here.shown_list
        first, fifth = lines.line(0), lines.line(4)
        assert (lines.line(0), lines.line(4)) == (first, fifth)

    act_on(SESSION, act)


def test_from_frame_to_reply_to_call_to_finding_and_back() -> None:
    async def act(pilot: Pilot[None]) -> None:
        assert "Frame 1, request of call 1 · answered in 6" in about(pilot)
        await pilot.press("r")
        assert "Frame 6, reply of call 1" in about(pilot)
        await pilot.press("r")
        assert "Frame 4, retry of call 1" in about(pilot)
        await pilot.press("c")
        assert screen(pilot).view == "calls"
        await pilot.press("right", "down", "down", "enter")
        assert "Frame 2, retry of call 1" in about(pilot)
        await pilot.press("w")
        assert screen(pilot).view == "findings"
        await pilot.press("w")
        assert "root cause" in note(pilot)
        await pilot.press("enter")
        assert "Frame 1," in about(pilot)
        await pilot.press("n", "n")
        assert "Frame 3," in about(pilot)
        await pilot.press("N")
        assert "Frame 2," in about(pilot)
        assert sorted(screen(pilot).frames.evidence) == [1, 2, 3, 4, 5, 6]

    act_on(STORY, act)


def test_the_filter_finds_as_one_types_and_tells_what_is_wrong() -> None:
    async def act(pilot: Pilot[None]) -> None:
        here = screen(pilot)
        await pilot.press("slash", *"serial > 25")
        await until(pilot, lambda: here.frames.count == run_count("serial > 25"))
        await pilot.press(*" and")
        error = here.query_one("#filter-error", Static)
        assert error.display
        assert "^" in str(error.content)
        assert here.frames.count == run_count("serial > 25")
        await pilot.press(*" kind == response")
        await until(pilot, lambda: here.frames.count == run_count("serial > 25 and kind == response"))
        assert not error.display
        await pilot.press("enter", "end")
        assert "Frame 518," in about(pilot)
        await pilot.press("escape")
        assert here.frames.count == 518
        assert "Frame 518," in about(pilot)
        await pilot.press("slash", *"sense", "escape")
        assert error.display
        await pilot.press("escape")
        assert not error.display

    act_on(SESSION, act)


def run_count(expression: str) -> int:
    """Count with the command line."""
    return len(run("decode", SESSION, "-f", expression).lines)


def test_following_client_handle_chain_and_command() -> None:
    async def act(pilot: Pilot[None]) -> None:
        here = screen(pilot)
        field = here.query_one("#filter", Input)
        await pilot.press("X")
        await until(pilot, lambda: here.frames.count == 2)
        assert field.value == "frame in (1, 2)"
        await pilot.press("escape", "C")
        await until(pilot, lambda: here.frames.count == 518)
        await pilot.press("escape", "H")
        assert "no handle" in note(pilot)
        here.go_to_frame(9)
        await pilot.press("K")
        assert field.value == 'function == Robot_Execute and command == "Motor"'
        await pilot.press("escape")
        here.go_to_frame(9)
        await pilot.press("H")
        assert here.view == "calls"
        assert field.value.endswith("arg[0] == 2")
        await until(pilot, lambda: here.calls.count > 200)

    act_on(SESSION, act)


def test_going_to_a_number_or_a_moment() -> None:
    async def act(pilot: Pilot[None]) -> None:
        for typed, wanted in (("300", "Frame 300,"), ("4.37s", "Frame 513,"), ("999999", "Frame 518,")):
            await pilot.press("ctrl+g", *typed, "enter")
            await until(pilot, lambda wanted=wanted: wanted in about(pilot))  # type: ignore[misc]
        await pilot.press("ctrl+g", *"[/x]", "enter")
        await until(pilot, lambda: "neither a number" in note(pilot))
        await pilot.press("ctrl+g", "escape")
        assert "Frame 518," in about(pilot)

    act_on(SESSION, act)


def test_marks_and_notes_are_saved_in_a_new_file(tmp_path: Path) -> None:
    source = tmp_path / "a.pcapng.gz"
    source.write_bytes(gzip.compress(STORY.read_bytes()))
    before = source.read_bytes()

    async def act(pilot: Pilot[None]) -> None:
        await pilot.press("down", "m", "down", "e", *"look [/here]", "enter")
        await until(pilot, lambda: screen(pilot).frames.marks == {2: "", 3: "look [/here]"})
        assert "# look [/here]" in about(pilot)
        await pilot.press("s")
        await pilot.pause()
        assert pilot.app.screen.query_one("#prompt-input", Input).value == str(tmp_path / "a-notes.pcapng")
        await pilot.press("enter")
        await until(pilot, lambda: "Saved" in note(pilot))
        await pilot.press("s", "enter")
        await until(pilot, lambda: "exists" in note(pilot))

    act_on(source, act)
    assert source.read_bytes() == before
    with open_capture(tmp_path / "a-notes.pcapng") as capture:
        comments = [packet[4] for packet in capture]
    assert comments[1][-1:] == ("marked",)
    assert comments[2][-1:] == ("look [/here]",)


def test_another_capture_is_opened_and_remembered(tmp_path: Path) -> None:
    with shown(STORY, settings=tmp_path / "screen.yaml") as (app, feed):

        async def act(pilot: Pilot[None]) -> None:
            await read(pilot, feed)
            here = screen(pilot)
            await pilot.press("m", "slash", *"frame > 2", "enter", "o")
            await pilot.pause()
            field = app.screen.query_one("#prompt-input", Input)
            assert field.value == f"{CAPTURES}/"
            field.value = str(tmp_path / "none.pcap")
            await pilot.press("enter")
            await until(pilot, lambda: "no such file" in note(pilot))
            here._open_capture(str(SESSION))
            await until(pilot, lambda: here.frames.count == 518)
            assert here.frames.marks == {}
            assert "slave-session.pcapng" in here.query_one(ViewBar)._states[0]
            names = [name for name, _, _ in here.commands()]
            assert names == [f"Open {SESSION}", f"Open {STORY}"]
            await app.run_action("open_recent(1)", here)
            await until(pilot, lambda: here.frames.count == 6)

        drive(app, act)
    assert read_settings(tmp_path / "screen.yaml")[0].captures == [str(STORY), str(SESSION)]


def test_bytes_and_fields_light_each_other() -> None:
    async def act(pilot: Pilot[None]) -> None:
        here = screen(pilot)
        await pilot.press("enter", "down", "down")
        assert pilot.app.focused is here.query_one("#fields")
        lit = here.query_one("#bytes")
        assert lit._highlighted == (0, 5, 7)  # type: ignore[attr-defined]  # serial
        await pilot.press("tab", *["right"] * 5)
        assert lit._highlighted == (0, 9, 13)  # type: ignore[attr-defined]  # function id
        tree = here.query_one("#fields")
        assert "function id" in tree.line(tree.cursor)  # type: ignore[attr-defined]

    act_on(STORY, act, (160, 48))


def test_live_traffic_is_followed_until_one_looks_at_something(tmp_path: Path) -> None:
    path = tmp_path / "growing.pcapng"
    with open_capture(SESSION) as capture:
        packets = list(capture)
    file = path.open("wb", buffering=0)
    writer = PcapngWriter(file)
    for packet in packets[:100]:
        writer.write(packet)
    with shown(path, follow=True) as (app, _):

        async def act(pilot: Pilot[None]) -> None:
            here = screen(pilot)
            await until(pilot, lambda: here.frames.frame_number == 100)
            for packet in packets[100:200]:
                writer.write(packet)
            await until(pilot, lambda: here.frames.frame_number == 200)
            await pilot.press("up")
            for packet in packets[200:]:
                writer.write(packet)
            await until(pilot, lambda: here.frames.count == 518)
            assert here.frames.frame_number == 199
            await pilot.press("S")
            await until(pilot, lambda: here.feed.progress.ended)

        drive(app, act)
    file.close()


@pytest.mark.parametrize("size", [(60, 16), (80, 24), (200, 50)])
def test_any_size_and_another_one(size: tuple[int, int]) -> None:
    async def act(pilot: Pilot[None]) -> None:
        for columns, rows in (size, (100, 30), size):
            await pilot.resize_terminal(columns, rows)
            await pilot.pause()
            lines = drawn(pilot.app).splitlines()  # type: ignore[arg-type]
            assert len(lines) == rows
            assert "Help" in lines[-1]
            assert "Frame 1," in drawn(pilot.app)  # type: ignore[arg-type]

    act_on(STORY, act, size)


def test_no_such_capture_and_a_damaged_one(tmp_path: Path) -> None:
    cut = tmp_path / "cut.pcapng"
    cut.write_bytes(SESSION.read_bytes()[:-10])

    async def act(pilot: Pilot[None]) -> None:
        await until(pilot, lambda: "ends inside" in note(pilot))
        assert screen(pilot).frames.count == 517

    act_on(cut, act)

    async def nothing(pilot: Pilot[None]) -> None:
        await until(pilot, lambda: "no such file" in note(pilot))
        await pilot.press("r", "c", "w", "m", "X", "1", "2", "enter", "3", "enter", "s")
        assert "no packets" in note(pilot)

    missing = tmp_path / "gone.pcap"
    shutil.copy(STORY, missing)
    missing.unlink()
    with shown(missing) as (app, feed):

        async def when_ended(pilot: Pilot[None]) -> None:
            await until(pilot, lambda: feed.progress.ended)
            feed.progress = type(feed.progress)(ended=True)
            await nothing(pilot)

        drive(app, when_ended)


def test_no_color_shows_no_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")

    async def act(pilot: Pilot[None]) -> None:
        app = pilot.app
        ground = Color.parse(app.theme_variables["background"])
        colors = {
            color.get_truecolor()
            for strip in app.screen._compositor.render_strips()
            for segment in app._filters[-1].apply(list(strip), ground)
            if segment.style is not None
            for color in (segment.style.color, segment.style.bgcolor)
            if color is not None
        }
        assert colors
        assert all(red == green == blue for red, green, blue in colors)
        assert all(style.color is None for style in app.text_styles.values())  # type: ignore[attr-defined]

    act_on(STORY, act)


def test_japanese() -> None:
    with shown(STORY, language=Language.JAPANESE) as (app, feed):

        async def act(pilot: Pilot[None]) -> None:
            await read(pilot, feed)
            text = drawn(app)
            assert "フレーム 6" in text
            assert "フィルタ" in text
            assert "呼び出し 1 の要求" in text

        drive(app, act)
