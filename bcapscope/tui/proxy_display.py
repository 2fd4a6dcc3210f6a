"""Texts and lists of the proxy screen: summary, clients, rules, held messages and their edits."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence

from msgspec.structs import astuple

from bcapscope.faults.fault_notation import rewrite_message
from bcapscope.protocol.codec.frame import Frame, parse_datagram
from bcapscope.proxy.control_messages import ClientStatus, FaultStatus, HeldStatus, ProxyStats, RelayDelays
from bcapscope.proxy.ring_buffer import SET_POINT_DEADLINE_NS
from bcapscope.render.escape import printable
from bcapscope.render.value_text import untyped_text
from bcapscope.traffic.observation import Flow
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label
from bcapscope.tui.widgets.lines import ItemList, TextList
from bcapscope.tui.widgets.record_lists import left_aligned, right_aligned

_SILENT_AFTER = 1.0  # seconds by which the client's latest data is newer than the controller's

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
    follows_end = True

    def add_message(self, text: str) -> None:
        if len(self.items) < _MAX_MESSAGES:
            self.add_item(f" {printable(text)}")


def _duration_text(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02}" if whole < 3600 else f"{whole // 3600}h{whole // 60 % 60:02}"


def summary_lines(figures: ProxyStats) -> list[str]:
    """Return a summary of the proxy in at most five lines, styled with marks of `INK`."""
    delays = figures.delays_ns
    passed, wrong = list(_traffic_counts(figures)), list(_problem_counts(figures))
    counts = [passed, wrong] if len(passed) > 1 else [passed + wrong]  # leaves room on narrow terminals
    lines = [
        _delay_line("proxy.held.up", astuple(delays)[:4]),
        _delay_line("proxy.held.down", astuple(delays)[4:8]),
        *(f" {' · '.join(each)}" for each in counts),
    ]
    return lines + ([_slow_warning(delays)] if delays.slow else [])


def _delay_line(key: str, times: Sequence[int]) -> str:
    p50, p99, p999, most = (f"{INK.number}{time / 1000:,.0f}{INK.reset}" for time in times)
    return f" {label(key)}  p50 {p50}  p99 {p99}  p99.9 {p999}  {label('proxy.most')} {most} µs"


def _traffic_counts(figures: ProxyStats) -> Iterator[str]:
    is_tcp = figures.bytes_up or figures.bytes_down
    if figures.came_up or figures.came_down or not is_tcp:  # a transport without traffic gets no line
        up, down = f"{figures.came_up:,}/{figures.left_up:,}", f"{figures.came_down:,}/{figures.left_down:,}"
        yield label("proxy.datagrams", up=up, down=down)
    if is_tcp:
        yield label("proxy.tcp", up=f"{figures.bytes_up:,}", down=f"{figures.bytes_down:,}")


def _problem_counts(figures: ProxyStats) -> Iterator[str]:
    if figures.are_scripts_off:
        yield f"{INK.problem}{label('proxy.script.off')}{INK.reset}"
    yield label("proxy.faults", count=f"{sum(figures.injected.values()):,}")
    if figures.guard:
        yield label("proxy.refused", count=f"{figures.refused:,}")
    for key, count in (("lost", figures.lost + figures.full), ("denied", figures.denied)):
        ink = INK.problem if count else ""
        if count or key == "lost":
            yield f"{ink}{label(f'proxy.{key}', count=f'{count:,}')}{INK.reset if ink else ''}"
    if figures.unwatched:
        yield f"{INK.problem}{label('proxy.not-recorded', count=f'{figures.unwatched:,}')}{INK.reset}"


def _slow_warning(delays: RelayDelays) -> str:
    worst = max(delays.most_up, delays.most_down) / 1e6
    text = label(
        "proxy.slow", count=f"{delays.slow:,}", limit=SET_POINT_DEADLINE_NS // 1_000_000, worst=f"{worst:.1f}"
    )
    return f"{INK.problem} {text}{INK.reset}"


def intercept_line(figures: ProxyStats) -> str:
    """Return an escaped line that shows which messages the proxy holds. The line contains ink marks."""
    if figures.intercept is None:
        return f"{INK.dim} {label('proxy.intercept.none')}{INK.reset}"
    return f" {label('proxy.intercept.is')} {INK.name}{printable(figures.intercept)}{INK.reset}"


_HEX = re.compile(r"[0-9A-Fa-f\s]+")
_BARE = re.compile(r'[^\s"]+')


def edited_message(data: bytes, flow: Flow, text: str) -> bytes:
    """Apply the user's edit to a held message. The edit is the new bytes in hex, or changes in the notation
    of the fault ``rewrite``, such as ``set arg[2]=0 serial 7``. Raises `ValueError` if the edit is invalid or
    changes nothing.
    """
    if not text.strip():
        raise ValueError(label("proxy.edit.empty"))
    if _HEX.fullmatch(text):
        try:
            return bytes.fromhex(text)
        except ValueError:
            raise ValueError(label("proxy.edit.hex")) from None
    edited = rewrite_message(data, flow, text)
    if edited == data:
        raise ValueError(label("proxy.edit.same"))
    return edited


def proposed_edit(data: bytes, offset: int) -> str:
    """Return an edit such as ``set arg[2]=0``, with the present value of the argument at a byte offset.

    If no argument is at `offset`, or if this argument cannot be written as text, use the last argument that
    can be written as text. Return "" if there is no such argument, or if `data` does not begin with a valid
    frame.
    """
    frame = next(iter(parse_datagram(data)), None)
    if not isinstance(frame, Frame) or frame.problems:
        return ""
    numbered = list(enumerate(frame.arguments))
    here = [(index, each) for index, each in numbered if each.start <= offset < each.stop]
    for index, argument in (*here, *reversed(numbered)):
        text = untyped_text(argument.variant)
        if text is not None:
            return f"set arg[{index}]={_typeable_text(text)}"
    return ""


def _typeable_text(text: str) -> str:
    """Return the text that the user would type for a string argument, with invisible characters escaped."""
    is_plain = text.isprintable()
    return text if is_plain and _BARE.fullmatch(text) else json.dumps(text, ensure_ascii=not is_plain)
