"""The summary above the lists of the proxy screen: forwarding delay and lost packets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from msgspec.structs import astuple

from bcapscope.proxy.control_messages import ProxyStats, RelayDelays
from bcapscope.proxy.ring_buffer import SET_POINT_DEADLINE_NS
from bcapscope.render.escape import printable
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import label


def summary_lines(figures: ProxyStats) -> list[str]:
    """Return the summary in at most five lines, with marks of `INK`."""
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
    """Return the line that says which messages the proxy holds, escaped and with marks of `INK`."""
    if figures.intercept is None:
        return f"{INK.dim} {label('proxy.intercept.none')}{INK.reset}"
    return f" {label('proxy.intercept.is')} {INK.name}{printable(figures.intercept)}{INK.reset}"
