"""The lists of a proxy's screen: clients, rules, messages that wait, what the proxy told."""

from __future__ import annotations

from typing import Generic, TypeVar

from rich.cells import cell_len

from bcapscope.proxy.control_answers import Client, Held, Rule
from bcapscope.render.escape import printable
from bcapscope.tui.ink import INK
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.words import say

_SILENT = 1.0
"""Seconds without an answer to the last request after which that is said."""

_MOST_TOLD = 5000

T = TypeVar("T", Client, Rule, Held)


class Listing(Lines, Generic[T]):
    """Shows items that are told anew from time to time; the cursor stays on the same one."""

    EMPTY = ""

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.items: list[T] = []

    def name_of(self, item: T) -> object:
        """Return what an item is known by."""
        raise NotImplementedError

    def write(self, item: T) -> str:
        """Return the line of an item."""
        raise NotImplementedError

    def show(self, items: list[T]) -> None:
        """Show these items."""
        if items == self.items:
            return
        here = self.current
        names = [self.name_of(item) for item in items]
        same = names == [self.name_of(item) for item in self.items]
        self.items = items
        if same and items:
            self.repaint()
            return
        at = self.cursor
        if here is not None and self.name_of(here) in names:
            at = names.index(self.name_of(here))
        self.changed(at)

    @property
    def current(self) -> T | None:
        """The item under the cursor."""
        return self.items[self.cursor] if self.cursor < len(self.items) else None

    @property
    def count(self) -> int:
        """How many lines there are; one says that there are no items."""
        return max(len(self.items), 1)

    def line(self, index: int) -> str:
        """Write a line."""
        if index < len(self.items):
            return self.write(self.items[index])
        return f"{INK.dim} {say(self.EMPTY)}{INK.reset}"


class ClientList(Listing[Client]):
    """Shows who is there."""

    EMPTY = "proxy.empty.clients"

    def name_of(self, item: Client) -> object:
        """Return the number."""
        return item.number

    def head(self) -> str:
        """Return what stands above the columns."""
        return (
            f" {_left(say('proxy.head.client'), 21)} {_left(say('proxy.head.transport'), 4)}"
            f" {_right(say('proxy.head.since'), 7)} {_right(say('proxy.head.up'), 8)}"
            f" {_right(say('proxy.head.down'), 8)} {_right(say('proxy.head.heard'), 8)}"
            f"  {say('proxy.head.upstream')}"
        )

    def write(self, item: Client) -> str:
        """Write a client."""
        heard = "" if item.heard_s is None else f"{item.heard_s:.1f} s"
        text = f"{item.client:<21} {item.transport:<4} {_span(item.since_s):>7} {item.up:>8,} {item.down:>8,}"
        return f" {printable(text)} {heard:>8}  {_upstream(item)}"


def _upstream(client: Client) -> str:
    """Say how the controller does, as this client sees it."""
    heard, answered = client.heard_s, client.answered_s
    if client.upstream in ("refused", "connecting"):
        return f"{INK.bad}{say(f'proxy.upstream.{client.upstream}')}{INK.reset}"
    if answered is None:
        key = "proxy.upstream.unanswered" if client.up else "proxy.upstream.open"
        return f"{INK.bad if client.up else INK.dim}{say(key)}{INK.reset}"
    if heard is not None and answered - heard > _SILENT:
        return f"{INK.bad}{say('proxy.upstream.silent', seconds=f'{answered:.0f}')}{INK.reset}"
    return f"{INK.good}{say('proxy.upstream.answers')}{INK.reset}"


class RuleList(Listing[Rule]):
    """Shows the faults and whether they are on."""

    EMPTY = "proxy.empty.rules"

    def name_of(self, item: Rule) -> object:
        """Return the name."""
        return item.name

    def head(self) -> str:
        """Return what stands above the columns."""
        name, struck = _left(say("proxy.head.rule"), 16), _right(say("proxy.head.struck"), 8)
        return f"       {name} {struck}  {say('proxy.head.what')}"

    def write(self, item: Rule) -> str:
        """Write a fault."""
        state = f"{INK.good}●{INK.reset}" if item.on else f"{INK.dim}○{INK.reset}"
        word = _left(say("proxy.on" if item.on else "proxy.off"), 4)
        struck = f"{INK.number}{item.struck:>8,}{INK.reset}"
        name = _left(printable(item.name), 16)
        return f" {state} {word}{INK.name}{name}{INK.reset} {struck}  {printable(item.rule)}"


class HeldList(Listing[Held]):
    """Shows the messages that wait."""

    EMPTY = "proxy.empty.held"

    def name_of(self, item: Held) -> object:
        """Return the number."""
        return item.number

    def head(self) -> str:
        """Return what stands above the columns."""
        return (
            f" {_right('#', 4)} {_left(say('proxy.head.client'), 21)} {_left('', 8)}"
            f" {_right(say('proxy.head.left'), 7)}  {say('proxy.head.message')}"
        )

    def write(self, item: Held) -> str:
        """Write a message."""
        what = " ".join(filter(None, (item.function, item.command)))
        left = f"{item.left_s:.0f} s"
        text = f"{item.number:>4} {item.client:<21} {item.direction:<8} {left:>7}"
        return f" {printable(text)}  {INK.name}{printable(what)}{INK.reset}"


class Told(Lines):
    """Shows what the proxy said, the last of it in sight."""

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._said: list[str] = []

    def add(self, text: str) -> None:
        """Show one more line."""
        if len(self._said) < _MOST_TOLD:
            self._said.append(printable(text))
            if self.lines == 1:
                self.changed()
            else:
                self.grown()

    @property
    def follows(self) -> bool:
        """A cursor on the last line goes along."""
        return True

    @property
    def lines(self) -> int:
        """How many there are."""
        return len(self._said)

    @property
    def count(self) -> int:
        """How many lines are shown; one says that there are none."""
        return max(len(self._said), 1)

    def line(self, index: int) -> str:
        """Return a line."""
        if index < len(self._said):
            return f" {self._said[index]}"
        return f"{INK.dim} {say('proxy.empty.told')}{INK.reset}"


def _left(text: str, width: int) -> str:
    return text + " " * (width - cell_len(text))


def _right(text: str, width: int) -> str:
    return " " * (width - cell_len(text)) + text


def _span(seconds: float) -> str:
    """Write a length of time in few characters."""
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02}" if whole < 3600 else f"{whole // 3600}h{whole // 60 % 60:02}"
