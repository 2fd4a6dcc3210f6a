"""What the player tells: who is there, one line while it plays, a summary at the end."""

from __future__ import annotations

from collections.abc import Iterator

import orjson

from bcapscope.player.lateness import Spread
from bcapscope.player.player_messages import (
    ControllerInfo,
    PlayCounts,
    PlayEnded,
    PlayerProblem,
    PlayOutcome,
    PlayProgress,
)
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.protocol.text_format import counted
from bcapscope.render.escape import printable
from bcapscope.render.tongue import Tongue, english

_HEADLINES = {
    PlayOutcome.DONE: "played to the end",
    PlayOutcome.LOOKED: "looked at; nothing was moved",
    PlayOutcome.STOPPED: "stopped on the way, at rest",
    PlayOutcome.HALTED: "halted",
    PlayOutcome.UNARMED: "not played",
    PlayOutcome.DECLINED: "not played",
    PlayOutcome.UNFIT: "not fit to play",
    PlayOutcome.REFUSED: "ended by the controller",
    PlayOutcome.UNANSWERED: "given up: no answer",
    PlayOutcome.UNWRITABLE: "a file was not written",
    PlayOutcome.FAILED: "failed",
}
_STOPPED_BEFORE = "stopped before the first set point"
_COUNT_LABELS = {
    "retries": ("retry", "retries"),
    "late": ("late reply", "late replies"),
    "unanswered": ("unanswered",) * 2,
    "repeated": ("sent again since the buffer was full",) * 2,
    "shifted": ("put off since we were late",) * 2,
    "held": ("held back since the controller set no pace",) * 2,
}
"""How one of each and how several are told."""

RETRIES_EXPECTED = (
    "about three retries per set point are normal here: the reply waits for the controller's cycle of 8 ms, "
    "and the time-out is 2 ms"
)
"""DENSO Wave 2009, How to use the Slave mode: its values for Sync over UDP."""


def controller_line(peer: ControllerInfo, tongue: Tongue = english) -> str:
    """Tell who is there and which mode it will be."""
    kind = "bcapscope's simulator, no robot moves" if peer.simulator else "a controller whose robot may move"
    facts = [tongue(f"{name} {printable(value)}") for name, value in peer.facts.items()]
    mode = peer.slave_mode
    meaning = f": {tongue(mode.text)}" if mode else ""
    entered = tongue(f"slave mode 0x{peer.mode:03X}")
    return f"{', '.join((tongue(kind), peer.generation, *facts))}; {entered}{meaning}"


def trouble_lines(trouble: PlayerProblem) -> Iterator[str]:
    """Tell what went wrong, and each error that the controller shows."""
    yield printable(trouble.text)
    for code, text in trouble.errors:
        yield f"  the controller shows {hresult_name(code)}: {printable(text)}"


def progress_line(progress: PlayProgress, width: int) -> str:
    """Write progress in one line of at most `width` characters."""
    of = f"/{progress.of}" if progress.of else ""
    left = "" if progress.left is None else f", {progress.left:.1f} s left"
    counts, late = progress.counts, progress.lateness
    parts = [f"{progress.state} {progress.index}{of}, {progress.elapsed:.1f} s{left}"]
    if late.count:
        parts.append(f"late ms p99.9 {late.p999 / 1e6:.3f} max {late.most / 1e6:.3f}")
    parts.append(f"retries {counts.retries}")
    if progress.returned:
        parts.append(" ".join(f"{value:.2f}" for value in progress.returned))
    return "  ".join(parts)[:width]


def play_summary_lines(ended: PlayEnded) -> Iterator[str]:
    reason = f": {printable(ended.reason.splitlines()[0])}" if ended.reason else ""
    unbegun = ended.outcome is PlayOutcome.STOPPED and not ended.index
    yield f"{_STOPPED_BEFORE if unbegun else _HEADLINES[ended.outcome]}{reason}"
    yield from (f"  {printable(line.strip())}" for line in ended.reason.splitlines()[1:])
    if ended.counts.sent:
        counts = [(getattr(ended.counts, name), labels) for name, labels in _COUNT_LABELS.items()]
        told = [counted(count, *labels) for count, labels in counts if count]
        yield f"set points: {ended.counts.sent} sent, {', '.join(told) or 'each answered at its first try'}"
        if ended.counts.retries and ended.retries_expected:
            yield RETRIES_EXPECTED
        priority = "with" if ended.realtime else "without"
        yield f"lateness, ms: {_spread_text(ended.lateness)}, {priority} real-time priority"
        yield f"from one set point to the next, ms: {_spread_text(ended.cycle)}"
    if ended.logged:
        yield f"{ended.logged} records of the controller's log saved"
    if not ended.left:
        yield "the controller did not let us leave in order: it may hold this session, its arm or slave mode"


def play_summary_record(ended: PlayEnded) -> bytes:
    """Write the summary as a JSON object; times are ms, the reason is escaped as on a terminal."""
    counts = {name: getattr(ended.counts, name) for name in PlayCounts.__struct_fields__}
    return orjson.dumps(
        {
            "outcome": ended.outcome.value,
            "reason": printable(ended.reason),
            "set_points": ended.index,
            **counts,
            "lateness_ms": _spread_record(ended.lateness),
            "cycle_ms": _spread_record(ended.cycle),
            "realtime": ended.realtime,
            "left_in_order": ended.left,
            "log_records": ended.logged,
        }
    )


def _spread_text(spread: Spread) -> str:
    points = (("p50", spread.p50), ("p99", spread.p99), ("p99.9", spread.p999), ("max", spread.most))
    return ", ".join(f"{name} {value / 1e6:.3f}" for name, value in points)


def _spread_record(spread: Spread) -> dict[str, float]:
    return {name: getattr(spread, name) / 1e6 for name in ("p50", "p99", "p999", "most")}
