"""Lists of any length."""

from __future__ import annotations

from textual.pilot import Pilot

from bcapscope.tui.widgets.lines import Lines
from tests.tui.pilot import shown, until
from tests.tui.widgets.stage import on_stage, scope


class Numbers(Lines):
    """Counts; remembers which lines it was asked for."""

    def __init__(self, count: int, live: bool = False) -> None:
        super().__init__(id="numbers")
        self.there, self.follows_end = count, live
        self.asked: list[int] = []

    @property
    def count(self) -> int:
        return self.there

    def line(self, index: int) -> str:
        self.asked.append(index)
        return f"line {index} " + "x" * 200 + "end"


def numbers(pilot: Pilot[None]) -> Numbers:
    return pilot.app.screen.query_one(Numbers)


def test_only_what_is_in_sight_is_asked_for_and_only_once() -> None:
    async def act(pilot: Pilot[None]) -> None:
        lines = numbers(pilot)
        lines.reset_lines()
        await pilot.pause()
        assert "line 0 " in shown(scope(pilot))
        assert len(lines.asked) < 100
        await pilot.press("end")
        assert "line 999999 " in shown(scope(pilot))
        await pilot.press("home")
        assert len(lines.asked) < 200

    on_stage(lambda: Numbers(1_000_000), act)


def test_the_cursor_stays_in_sight_and_in_bounds() -> None:
    async def act(pilot: Pilot[None]) -> None:
        lines = numbers(pilot)
        lines.reset_lines()
        for key, wanted in (
            ("up", 0),
            ("down", 1),
            ("j", 2),
            ("k", 1),
            ("pagedown", 22),
            ("end", 49),
            ("down", 49),
            ("pageup", 28),
            ("G", 49),
            ("g", 0),
        ):
            await pilot.press(key)
            assert lines.cursor == wanted, key
            assert f"line {wanted} " in shown(scope(pilot))
        await pilot.resize_terminal(80, 10)
        await pilot.press("end")
        await pilot.resize_terminal(80, 6)
        await pilot.pause()
        assert "line 49 " in shown(scope(pilot))

    on_stage(lambda: Numbers(50), act)


def test_what_is_further_right_can_be_seen() -> None:
    async def act(pilot: Pilot[None]) -> None:
        numbers(pilot).reset_lines()
        await pilot.pause()
        assert "end" not in shown(scope(pilot))
        for _ in range(30):
            await pilot.press("right")
        await pilot.pause()
        assert "end" in shown(scope(pilot))
        for _ in range(30):
            await pilot.press("left")
        await pilot.pause()
        assert "line 3 " in shown(scope(pilot))

    on_stage(lambda: Numbers(5), act)


def test_only_live_lists_are_followed_and_only_from_the_last_line() -> None:
    for live in (False, True):

        async def act(pilot: Pilot[None], live: bool = live) -> None:
            lines = numbers(pilot)
            for there in (1, 10, 100):
                lines.there = there
                lines.lines_added()
                drawn = {0, min(there, 10) // 2, min(there, 10) - 1}
                await until(pilot, lambda drawn=drawn: drawn <= set(lines.asked))  # type: ignore[misc]
                assert lines.cursor == (there - 1 if live else 0)
            await pilot.press("home")
            lines.there = 200
            lines.lines_added()
            assert lines.cursor == 0

        on_stage(lambda live=live: Numbers(0, live), act)  # type: ignore[misc]


def test_an_empty_list_takes_every_key() -> None:
    async def act(pilot: Pilot[None]) -> None:
        numbers(pilot).reset_lines()
        await pilot.press("up", "down", "pageup", "pagedown", "home", "end", "left", "right", "enter")
        await pilot.click("#numbers", offset=(3, 3))
        assert numbers(pilot).cursor == 0

    on_stage(lambda: Numbers(0), act)


def test_a_click_goes_to_the_line() -> None:
    async def act(pilot: Pilot[None]) -> None:
        numbers(pilot).reset_lines()
        await pilot.press("end")
        await pilot.pause()
        await pilot.click("#numbers", offset=(5, 0))
        assert numbers(pilot).cursor == 50 - 22
        await pilot.click("#numbers", offset=(5, 4))
        assert numbers(pilot).cursor == 50 - 22 + 4

    on_stage(lambda: Numbers(50), act)


def test_the_scroll_bar_follows_the_number_of_lines_and_the_position() -> None:
    async def act(pilot: Pilot[None]) -> None:
        lines = numbers(pilot)
        lines.reset_lines()
        await pilot.pause()
        bar = lines.vertical_scrollbar
        lines.there = 1100
        lines.lines_added()
        assert bar.window_virtual_size == 1100
        await pilot.press("down")
        lines.scroll_to(y=1, animate=False, force=True)
        assert bar.position == lines.scroll_y == 1
        await pilot.press("end")
        assert bar.position == lines.scroll_y > 1000
        lines.there = 1200
        lines.lines_added()
        assert bar.window_virtual_size == 1200

    on_stage(lambda: Numbers(1000), act)


def test_lines_that_went_one_up_are_drawn_as_they_were() -> None:
    async def act(pilot: Pilot[None]) -> None:
        lines = numbers(pilot)
        lines.reset_lines()
        await pilot.pause()
        before = lines.render_lines(lines.size.region)
        lines.scroll_to(y=1, animate=False, force=True)
        after = lines.render_lines(lines.size.region)
        assert all(one is other for one, other in zip(before[1:], after[:-1], strict=True))

    on_stage(lambda: Numbers(1000), act)
