"""Keys in their order."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import ClassVar

import pytest
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.events import Event, Key, Paste
from textual.message import Message
from textual.screen import ModalScreen
from textual.widget import Widget
from textual.widgets import Input

from bcapscope.tui.key_order import KeyOrderApp
from tests.tui.pilot import until


class Asking(ModalScreen[None]):
    """A dialog with a field."""

    def compose(self) -> ComposeResult:
        yield Input(id="asked")


class Listing(Widget, can_focus=True):
    """What has the focus at first; its keys go elsewhere."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("slash", "find", ""),
        Binding("a", "ask", ""),
        Binding("x", "remove", ""),
    ]

    def action_find(self) -> None:
        self.screen.query_one("#find").focus()

    def action_ask(self) -> None:
        self.post_message(self.Asked())

    class Asked(Message):
        """A dialog is wanted."""

    async def action_remove(self) -> None:
        await self.remove()


class Room(KeyOrderApp):
    """A list and a field."""

    def on_listing_asked(self) -> None:
        self.push_screen(Asking())

    def compose(self) -> ComposeResult:
        yield Listing()
        yield Input(id="find")


def keys(text: str) -> list[Event]:
    return [Key("slash" if each == "/" else each, each) for each in text]


@pytest.mark.parametrize(
    ("events", "where", "text"),
    [
        (keys("/hresult"), "#find", "hresult"),
        ([*keys("/"), Paste("retries > 0"), *keys("1")], "#find", "retries > 01"),
        (keys("about"), "#asked", "bout"),
        (keys("xabc"), "#find", "abc"),
    ],
    ids=["typed", "pasted", "into a dialog", "from what is no more"],
)
def test_each_goes_where_the_one_before_has_left_the_focus(
    events: Iterable[Event], where: str, text: str
) -> None:
    async def run() -> None:
        async with asyncio.timeout(60), Room().run_test() as pilot:
            app = pilot.app
            app.screen.query_one(Listing).focus()
            await pilot.pause()
            assert app._driver is not None
            for event in events:  # all of them before the first is answered
                app._driver.send_message(event)
            await until(
                pilot, lambda: [each.value for each in app.screen.query(where).results(Input)] == [text]
            )

    asyncio.run(run())
