"""The lists of the proxy screen: clients, rules, held messages, and the proxy's log."""

from __future__ import annotations

from typing import Generic, TypeVar

from rich.cells import cell_len

from bcapscope.proxy.control_messages import ClientStatus, FaultStatus, HeldStatus
from bcapscope.render.escape import printable
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label
from bcapscope.tui.widgets.lines import Lines

_SILENT_AFTER = 1.0
"""Time in seconds after an unanswered request until the list shows the controller as silent."""

_MAX_MESSAGES = 5000

T = TypeVar("T", ClientStatus, FaultStatus, HeldStatus)


class ItemList(Lines, Generic[T]):
    """A list of items that the screen refreshes regularly; the cursor stays on the same item."""

    EMPTY = ""

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self.items: list[T] = []

    def key_of(self, item: T) -> object:
        raise NotImplementedError

    def item_line(self, item: T) -> str:
        raise NotImplementedError

    def show(self, items: list[T]) -> None:
        if items == self.items:
            return
        here = self.current_item
        names = [self.key_of(item) for item in items]
        same = names == [self.key_of(item) for item in self.items]
        self.items = items
        if same and items:
            self.repaint()
            return
        at = self.cursor
        if here is not None and self.key_of(here) in names:
            at = names.index(self.key_of(here))
        self.reset_lines(at)

    @property
    def current_item(self) -> T | None:
        """The item under the cursor; None if there is none."""
        return self.items[self.cursor] if self.cursor < len(self.items) else None

    @property
    def count(self) -> int:
        """Number of lines; an empty list has one line that says that the list is empty."""
        return max(len(self.items), 1)

    def line(self, index: int) -> str:
        if index < len(self.items):
            return self.item_line(self.items[index])
        return f"{INK.dim} {label(self.EMPTY)}{INK.reset}"


class ClientList(ItemList[ClientStatus]):
    EMPTY = "proxy.empty.clients"

    def key_of(self, item: ClientStatus) -> object:
        return item.number

    def header(self) -> str:
        return (
            f" {_left_aligned(label('proxy.head.client'), 21)} {' ' * 4}"
            f" {_right_aligned(label('proxy.head.since'), 7)} {_right_aligned(label('proxy.head.up'), 8)}"
            f" {_right_aligned(label('proxy.head.down'), 8)} {_right_aligned(label('proxy.head.last'), 8)}"
            f"  {label('proxy.head.upstream')}"
        )

    def item_line(self, item: ClientStatus) -> str:
        heard = "" if item.heard_s is None else f"{item.heard_s:.1f} s"
        connected = _duration_text(item.since_s)
        text = f"{item.client:<21} {item.transport:<4} {connected:>7} {item.up:>8,} {item.down:>8,}"
        return f" {printable(text)} {heard:>8}  {_upstream_text(item)}"


def _upstream_text(client: ClientStatus) -> str:
    """Return whether the controller answers this client, as text for the list."""
    heard, answered = client.heard_s, client.answered_s
    if client.upstream in ("refused", "connecting"):
        return f"{INK.bad}{label(f'proxy.upstream.{client.upstream}')}{INK.reset}"
    if answered is None:
        key = "proxy.upstream.unanswered" if client.up else "proxy.upstream.open"
        return f"{INK.bad if client.up else INK.dim}{label(key)}{INK.reset}"
    if heard is not None and answered - heard > _SILENT_AFTER:
        return f"{INK.bad}{label('proxy.upstream.silent', seconds=f'{answered:.0f}')}{INK.reset}"
    return f"{INK.good}{label('proxy.upstream.answers')}{INK.reset}"


class RuleList(ItemList[FaultStatus]):
    """Shows the proxy's rules and whether each rule is on."""

    EMPTY = "proxy.empty.rules"

    def key_of(self, item: FaultStatus) -> object:
        return item.name

    def header(self) -> str:
        name, injected = (
            _left_aligned(label("proxy.head.rule"), 16),
            _right_aligned(label("proxy.head.injected"), 8),
        )
        return f"       {name} {injected}  {label('proxy.head.what')}"

    def item_line(self, item: FaultStatus) -> str:
        state = f"{INK.good}●{INK.reset}" if item.on else f"{INK.dim}○{INK.reset}"
        word = _left_aligned(label("proxy.on" if item.on else "proxy.off"), 4)
        count = f"{INK.number}{item.injected:>8,}{INK.reset}"
        name = _left_aligned(printable(item.name), 16)
        return f" {state} {word}{INK.name}{name}{INK.reset} {count}  {printable(item.rule)}"


class HeldList(ItemList[HeldStatus]):
    """Shows the held messages."""

    EMPTY = "proxy.empty.held"

    def key_of(self, item: HeldStatus) -> object:
        return item.number

    def header(self) -> str:
        return (
            f" {_right_aligned('#', 4)} {_left_aligned(label('proxy.head.client'), 21)}"
            f" {_left_aligned('', 8)} {_right_aligned(label('proxy.head.left'), 7)}"
            f"  {label('proxy.head.message')}"
        )

    def item_line(self, item: HeldStatus) -> str:
        what = " ".join(filter(None, (item.function, item.command)))
        left = f"{item.left_s:.0f} s"
        text = f"{item.number:>4} {item.client:<21} {item.direction:<8} {left:>7}"
        return f" {printable(text)}  {INK.name}{printable(what)}{INK.reset}"


class ProxyLog(Lines):
    """Shows the proxy's log, scrolled to the end."""

    follows_end = True

    def __init__(self, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._messages: list[str] = []

    def add_message(self, text: str) -> None:
        if len(self._messages) < _MAX_MESSAGES:
            self._messages.append(printable(text))
            if self.message_count == 1:
                self.reset_lines()
            else:
                self.lines_added()

    @property
    def message_count(self) -> int:
        return len(self._messages)

    @property
    def count(self) -> int:
        """Number of lines; an empty log has one line that says that the log is empty."""
        return max(len(self._messages), 1)

    def line(self, index: int) -> str:
        if index < len(self._messages):
            return f" {self._messages[index]}"
        return f"{INK.dim} {label('proxy.empty.messages')}{INK.reset}"


def _left_aligned(text: str, width: int) -> str:
    return text + " " * (width - cell_len(text))


def _right_aligned(text: str, width: int) -> str:
    return " " * (width - cell_len(text)) + text


def _duration_text(seconds: float) -> str:
    """Return a duration as a short text."""
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02}" if whole < 3600 else f"{whole // 3600}h{whole // 60 % 60:02}"
