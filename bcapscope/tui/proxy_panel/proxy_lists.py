"""The lists on the proxy screen: clients, rules, held messages, and the proxy's log."""

from __future__ import annotations

from bcapscope.proxy.control_messages import ClientStatus, FaultStatus, HeldStatus
from bcapscope.render.escape import printable
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label
from bcapscope.tui.widgets.item_list import ItemList, TextList
from bcapscope.tui.widgets.record_list import left_aligned, right_aligned

_SILENT_AFTER = 1.0
"""Time in seconds after an unanswered request until the list shows the controller as silent."""

_MAX_MESSAGES = 5000


class ClientList(ItemList[ClientStatus]):
    def key_of(self, item: ClientStatus) -> object:
        return item.number

    def header(self) -> str:
        return (
            f" {left_aligned(label('proxy.head.client'), 21)} {' ' * 4}"
            f" {right_aligned(label('proxy.head.since'), 7)} {right_aligned(label('proxy.head.up'), 8)}"
            f" {right_aligned(label('proxy.head.down'), 8)} {right_aligned(label('proxy.head.last'), 8)}"
            f"  {label('proxy.head.upstream')}"
        )

    def item_line(self, item: ClientStatus) -> str:
        heard = "" if item.heard_s is None else f"{item.heard_s:.1f} s"
        connected = _duration_text(item.since_s)
        text = f"{item.client:<21} {item.transport:<4} {connected:>7} {item.up:>8,} {item.down:>8,}"
        return f" {printable(text)} {heard:>8}  {_upstream_text(item)}"


def _upstream_text(client: ClientStatus) -> str:
    """Return as text whether the controller answers the client."""
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

    def key_of(self, item: FaultStatus) -> object:
        return item.name

    def header(self) -> str:
        name = left_aligned(label("proxy.head.rule"), 16)
        return f"       {name} {right_aligned(label('proxy.head.injected'), 8)}  {label('proxy.head.what')}"

    def item_line(self, item: FaultStatus) -> str:
        state = f"{INK.good}●{INK.reset}" if item.on else f"{INK.dim}○{INK.reset}"
        word = left_aligned(label("proxy.on" if item.on else "proxy.off"), 4)
        count = f"{INK.number}{item.injected:>8,}{INK.reset}"
        name = left_aligned(printable(item.name), 16)
        return f" {state} {word}{INK.name}{name}{INK.reset} {count}  {printable(item.rule)}"


class HeldList(ItemList[HeldStatus]):
    def key_of(self, item: HeldStatus) -> object:
        return item.number

    def header(self) -> str:
        return (
            f" {right_aligned('#', 4)} {left_aligned(label('proxy.head.client'), 21)}"
            f" {' ' * 8} {right_aligned(label('proxy.head.left'), 7)}"
            f"  {label('proxy.head.message')}"
        )

    def item_line(self, item: HeldStatus) -> str:
        what = " ".join(filter(None, (item.function, item.command)))
        left = f"{item.left_s:.0f} s"
        text = f"{item.number:>4} {item.client:<21} {item.direction:<8} {left:>7}"
        return f" {printable(text)}  {INK.name}{printable(what)}{INK.reset}"


class ProxyLog(TextList):
    """Shows the proxy's log, scrolled to the end."""

    follows_end = True

    def add_message(self, text: str) -> None:
        if len(self.items) < _MAX_MESSAGES:
            self.add_item(f" {printable(text)}")


def _duration_text(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02}" if whole < 3600 else f"{whole // 3600}h{whole // 60 % 60:02}"
