"""Set points that come too late, too fast, or out of step with the controller's 8 ms."""

from __future__ import annotations

from collections import deque
from itertools import pairwise

from bcapscope.analysis.buffer import UNKNOWN_SLOTS, Starved, slack_ms
from bcapscope.analysis.client import Client, Clients, command_of
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.refusal import Refusal, Why, refusal
from bcapscope.analysis.rules.rule import MS, Incident, Kind, Report, Rule, Watcher
from bcapscope.analysis.speech import Speech, amount, called, name_of, span
from bcapscope.analysis.stay import Stay
from bcapscope.protocol.hresult import E_SLAVE_OVERFLOW, E_SLAVE_UNDERFLOW, S_BUF_FULL
from bcapscope.protocol.wording import counted
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.question import Question

_SEED = "DENSO Wave 2009, How to use the Slave mode"
_SAMPLES = "documentation of ShoheiKobata/orin_bcap_python_samples (table of slave modes)"

GAP = Rule(
    "set-point-gap",
    Severity.WARNING,
    "in motion, the time between two set points was longer than the controller's buffer can bridge",
    "Look at what the client did in that time: garbage collection, a busy thread, logging, waiting for "
    "another reply. Give the loop its own process with real-time priority, and let the waiting reply of mode "
    "2 set the pace.",
    f"{_SAMPLES}; DENSORobot/denso_robot_ros issues 20 and 49",
    ("late-reply", "client-gave-up", "no-reply", "retried", "reply-lost", "slow-retry"),
)
UNDERFLOW = Rule(
    "underflow",
    Severity.ERROR,
    "the controller ran out of set points while moving (84201482) and left slave mode",
    "Send a set point every 8 ms with at most 24 ms of slack (modes 0 and 2); send the present position a "
    "few times before the motion begins, and use mode 1 (0x1nn) where holding the last point is right.",
    f"{_SAMPLES}; DENSORobot/denso_robot_ros issues 20 and 49; orin_bcap issue 3",
    (
        "set-point-gap",
        "late-reply",
        "client-gave-up",
        "no-reply",
        "retried",
        "reply-lost",
        "slow-retry",
        "off-grid",
    ),
)
OVERFLOW = Rule(
    "overflow",
    Severity.ERROR,
    "set points came faster than the controller takes them (83201483, mode 0)",
    "After S_BUF_FULL wait one period; after 83201483 send the same point again; or use mode 2 (0x2nn), "
    "whose replies set the pace.",
    "ShoheiKobata/orin_bcap_python_samples 05_00_slvMove.py; DENSORobot/denso_robot_ros2 denso_robot_core",
    ("off-grid",),
)
OFF_GRID = Rule(
    "off-grid",
    Severity.WARNING,
    "set points do not come at the controller's period",
    "Pace the loop by absolute deadlines at 8 ms, or let the waiting reply of mode 2 pace it; the robot "
    "trembles otherwise.",
    "DENSORobot/denso_robot_ros2 issue 17; d-yui-hub/denso_robot_ros2_neo; " + _SEED,
)
UNPACED = Rule(
    "replies-do-not-pace",
    Severity.NOTE,
    "in a waiting mode, replies came faster than one each 8 ms over a long time",
    "A real controller holds the reply until it has room: expect a simulator, or another mode than "
    "you believe.",
    f"{_SAMPLES}; {_SEED}",
)

_EMPTY_CODES = (E_SLAVE_UNDERFLOW, 0x84400503, 0x83201684)
_FEW = 50
_TOLERANCE = 0.1
_STRAYING = 0.05
_RECENT = 8
_MOST_TOLD = 64


class Pacing(Watcher):
    """Looks at when set points came."""

    rules = (GAP, UNDERFLOW, OVERFLOW, OFF_GRID, UNPACED)

    def __init__(self, report: Report, clients: Clients) -> None:
        super().__init__(report, clients)
        self._told: deque[int] = deque(maxlen=_MOST_TOLD)

    def heeds(self, question: Question, kind: Kind) -> bool:
        return kind is Kind.REFUSED

    def call(self, call: Exchange, client: Client) -> None:
        """Look for the pause that explains an empty buffer; `stay` comes later and knows less of it."""
        pair = _pause_before(call, client) if call.hresult in _EMPTY_CODES else None
        if pair is None:
            return
        before, after = pair
        slack, pause = _slack(client), after.request.time - before.request.time
        self._told.append(after.request.number)
        self.tell(
            GAP,
            after,
            lambda speech: _pause_text(before, after, slack, speech),
            lambda speech, since: f"no set point was sent for {span(pause)}",
            before=before,
            because=(before.call,),
            began=before.request.time,
            time=after.request.time,
        )

    def stay(self, stay: Stay) -> None:
        if not stay.buffer.overwrites:
            self._list_starved(stay)
        cycle = stay.timing.cycle
        if cycle is None or cycle.count < _FEW:
            return
        grid = stay.timing.grid_ms
        off = cycle.mean / grid - 1
        if stay.buffer.paces and off < -_TOLERANCE:
            self._off(UNPACED, stay, cycle.mean, "")
        elif abs(off) > _TOLERANCE:
            self._off(OFF_GRID, stay, cycle.mean, "")
        elif stay.timing.skipped > cycle.count * _STRAYING:
            share = f", and {stay.timing.skipped} of {cycle.count} cycles took one and a half periods or more"
            self._off(OFF_GRID, stay, cycle.mean, share)

    def _list_starved(self, stay: Stay) -> None:
        listed = [starved for starved in stay.buffer.starved_list if starved.moving is not False]
        more = max(stay.buffer.starved_moving - len(listed), 0)
        untold = [starved for starved in listed if starved.before not in self._told]
        for starved in untold[:-1]:
            self._starved(stay, starved, 1)
        for starved in untold[-1:]:
            self._starved(stay, starved, 1 + more)

    def _starved(self, stay: Stay, starved: Starved, count: int) -> None:
        wait = round((starved.late_ms + stay.timing.slack_ms) * MS)

        def say(speech: Speech) -> str:
            return (
                f"the set point of frame {starved.before} came {span(round(starved.late_ms * MS))} after the "
                f"buffer of {counted(stay.buffer.slots, 'point')} must have been empty, while the robot "
                "moved (by a model of the buffer)"
            )

        def then(speech: Speech, after: int) -> str:
            return f"no set point came for {span(wait)}"

        frames = (starved.after, starved.before)
        began = starved.time - round(stay.timing.slack_ms * MS)
        self.report(Incident(GAP, began, starved.time, stay.conversation, frames, say, then, count=count))

    def _off(self, rule: Rule, stay: Stay, mean: float, more: str) -> None:
        first, last = stay.first, stay.last
        if first is None or last is None:
            return
        rate, grid = 1000 / mean if mean else 0, stay.timing.grid_ms

        def say(speech: Speech) -> str:
            who, points = speech.client(stay.conversation), counted(stay.counts.sent, "set point")
            return (
                f"{who} sent {points} every {amount(mean)} ms on average ({amount(rate)} a second), where "
                f"{grid:g} ms is the period{more}"
            )

        def then(speech: Speech, after: int) -> str:
            return f"set points came every {amount(mean)} ms"

        frames = (first.frame, last.frame)
        self.report(Incident(rule, first.time, last.time, stay.conversation, frames, say, then))


def _slack(client: Client) -> int:
    """Return how long the controller's buffer lasts, in nanoseconds, as far as the mode is known."""
    mode = client.slave_mode if client.mode_call else None
    return round(slack_ms(UNKNOWN_SLOTS if mode is None else mode.slots) * MS)


def _pause_before(call: Exchange, client: Client) -> tuple[Exchange, Exchange] | None:
    """Return the set points around the longest of the last pauses, if it is longer than the buffer lasts."""
    points = [*client.points, call] if command_of(call.question) == "slvmove" else list(client.points)
    pairs = [*pairwise(points[-_RECENT:])]
    pair = max(pairs, key=lambda pair: pair[1].request.time - pair[0].request.time) if pairs else None
    if pair is None or pair[1].request.time - pair[0].request.time <= _slack(client):
        return None
    return pair


def _pause_text(before: Exchange, after: Exchange, slack: int, speech: Speech) -> str:
    pause = span(after.request.time - before.request.time)
    when, who = speech.at(before.request.time), speech.client(before.conversation)
    text = (
        f"after {called(before)} at {when} {who} sent no set point for {pause}, and the buffer lasts "
        f"{span(slack)}"
    )
    reply = before.reply
    if reply is None:
        return f"{text}; {name_of(before)} was never answered"
    waited, idle = reply.time - before.request.time, after.request.time - reply.time
    if idle > waited:
        return f"{text}: its reply was there after {span(waited)}, and the next was sent {span(idle)} later"
    return f"{text}: the reply took {span(waited)}"


def _underflow(call: Exchange, client: Client, clients: Clients) -> Why | None:
    pair = _pause_before(call, client)
    code, slack = call.hresult or 0, _slack(client)

    def say(speech: Speech) -> str:
        when = speech.at(call.reply.time if call.reply is not None else call.request.time)
        text = (
            f"at {when} the controller said, in the reply to {called(call)}, that it had run out of set "
            f"points (0x{code:08X}), and left slave mode"
        )
        if pair is None:
            return f"{text}; the set points before that were never more than {span(slack)} apart"
        pause = span(pair[1].request.time - pair[0].request.time)
        return (
            f"{text}: none was sent for {pause} after {called(pair[0])}, and its buffer lasts {span(slack)}"
        )

    def then(speech: Speech, after: int) -> str:
        return f"the controller said{_later(after)} that it had run out of set points, and left slave mode"

    because = () if pair is None else (pair[1].call, pair[0].call)
    return Why(say=say, then=then, because=because, before=None if pair is None else pair[0])


def _later(nanoseconds: int) -> str:
    return f" {span(nanoseconds)} later" if nanoseconds > 0 else ""


def _overflow(call: Exchange, client: Client, clients: Clients) -> Why | None:
    points = list(client.points)[-_RECENT:]
    if len(points) < 2:
        return None
    each = (call.request.time - points[0].request.time) / len(points)
    full = [point for point in points if point.hresult == S_BUF_FULL]

    def text(speech: Speech) -> str:
        said = f"the {counted(len(points), 'set point')} before came every {span(round(each))}"
        if full:
            last = full[-1]
            said += f", and the reply to {name_of(last)} {last.last.item.serial} had said that"
            said += " the buffer was full"
        return said

    return Why(text, then=lambda speech, after: f"the controller's buffer overflowed{_later(after)}")


REFUSALS: tuple[Refusal, ...] = (
    refusal(UNDERFLOW, _EMPTY_CODES, _underflow),
    refusal(OVERFLOW, (E_SLAVE_OVERFLOW, 0x84400502), _overflow),
    refusal(OVERFLOW, (E_SLAVE_OVERFLOW, 0x84400502)),
)
