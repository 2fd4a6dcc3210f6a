"""The process that watches a proxy: it records, decodes, shows and judges, and never holds the relay up.

It looks every few hundredths of a second at what the relay has written into the ring. When the relay ends,
or is killed, it takes what is left, closes the recording and sums up.
"""

from __future__ import annotations

import gc
import json
import shutil
import signal
import time
from collections.abc import Iterable
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory

from bcapscope.analysis.diagnosis import Diagnosis
from bcapscope.analysis.rules.session import IN_SLAVE_MODE
from bcapscope.cli.courtesy import Haste, step_back, turns_for_others
from bcapscope.cli.output import palette
from bcapscope.cli.proxyrecord import ProxyRecorder
from bcapscope.cli.proxystatus import Delays, losses, rates, totals
from bcapscope.cli.proxyview import View
from bcapscope.cli.proxywishes import FAREWELL, READY, Wishes
from bcapscope.cli.screen import Screen
from bcapscope.protocol.wording import counted
from bcapscope.proxy.farewell import Farewells
from bcapscope.proxy.ring import Count, Kind, Record, RingReader
from bcapscope.proxy.vigil import Vigil
from bcapscope.proxy.witness import Witness
from bcapscope.render.escape import printable
from bcapscope.render.findings import FindingsRenderer
from bcapscope.traffic.exchange import Exchange, Settled
from bcapscope.traffic.handles import Handles
from bcapscope.traffic.lane import RETRY_WITHIN_NS
from bcapscope.traffic.observation import Conversation, Transport
from bcapscope.traffic.tracker import Tracker

TICK = 0.025
"""Seconds between looks at the ring."""

_SPELL = 0.024
"""Seconds of decoding between two looks, in which what comes is not recorded."""

_MAY_WAIT = 0.25
"""Share of the ring up to which others have most of the time for themselves though more comes than a spell is
enough for: a processor that is taken costs each round trip."""

_LATEST = 2_000_000_000
"""ns after which what passed is shown, whatever that costs; as long as there is a processor for it."""

_REST, _LONGEST_REST = 1.5, 0.075
"""How long that time is, as a multiple of what a look took, and s at most."""

_STATUS_EVERY = 500_000_000
_MARGIN = round(3 * TICK * 1e9)
"""ns that something may have passed before it is seen here."""

_NICENESS = 10
_AT_ONCE = 128
"""Records that are shown together."""
_PIECE = 32
"""Records that are recorded before others have their turn."""
_FEW = 4
"""Frames that are decoded before they have: to ask whether they wait takes a quarter of the time of one."""

_CATCHES_UP_WITHIN = 10.0
"""Seconds that what is left may take at the end to be decoded; all of it is recorded."""


def watch_relay(memory: str, relay: Connection, wishes: Wishes) -> bool:
    """Watch a relay until it ends.

    Args:
        memory: name of the ring's.
        relay: over which it asks and is answered; its end is the relay's.
        wishes: what is to be done.

    Returns:
        Whether the recording, if one was requested, is complete.
    """
    _leave_to_relay()
    screen = Screen()
    recorder = None
    try:
        if wishes.record is not None:
            recorder = ProxyRecorder(wishes.record, wishes.bounds, screen.tell)
    except OSError as error:
        relay.send_bytes((error.strerror or str(error)).lower().encode())
        return False
    shared = SharedMemory(memory)
    assert shared.buf is not None
    reader = RingReader(shared.buf)
    ahead = RingReader(shared.buf, ahead=True)
    relay.send_bytes(READY)
    try:
        Watcher(reader, wishes, screen, None if recorder is None else Scribe(ahead, recorder)).run(relay)
    finally:
        if recorder is not None:
            recorder.close()
        screen.close()
        has_lost = reader.counts[Count.UNWATCHED] > 0
        for end in (reader, ahead):
            end.release()
        shared.close()
    return recorder is None or not (recorder.failed or has_lost)


def _leave_to_relay() -> None:
    """Leave the processor, and the signals that the terminal sends, to the relay."""
    for name in ("SIGINT", "SIGHUP", "SIGTERM"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    step_back(_NICENESS)
    gc.freeze()


class Scribe:
    """Records what the relay wrote, ahead of all that is made of it.

    Attributes:
        reader: reads for it; what it has read stays in the ring until it is decoded as well.
    """

    def __init__(self, reader: RingReader, recorder: ProxyRecorder) -> None:
        """Take a reader that is ahead of the watcher's, and what writes."""
        self.reader = reader
        self._recorder = recorder
        self._pause = turns_for_others(reader)

    def write(self) -> None:
        """Record what there is; the first look may only find how much that is."""
        until = self.reader.written
        while self.reader.place < until:
            self._recorder.take(self.reader.take(_PIECE))
            self._pause()
        self._recorder.flush()


class Watcher:
    """Takes what the relay wrote, and does with it what is wished.

    What waits to be decoded waits in the ring, whose size is fixed. Who has gone is forgotten; beside the
    clients that are there, of whom the relay has a limit, it holds what tracker and diagnosis bound.
    """

    def __init__(
        self, reader: RingReader, wishes: Wishes, screen: Screen, scribe: Scribe | None = None
    ) -> None:
        self._reader = reader
        self._wishes = wishes
        self._screen = screen
        self._scribe = scribe
        self._pause = turns_for_others(reader)
        self._written = self._seen = 0
        self._colors = palette(wishes.color)
        self._view = View(wishes.look, self._colors)
        self._witness = Witness()
        self._tracker = Tracker()
        self._diagnosis = Diagnosis()
        self._handles = Handles(most_over=0)
        self._farewells = Farewells(self._handles)
        self._vigil = Vigil()
        self._delays = Delays()
        self._advice = ""
        self._bade_farewell = False
        self._calls = self._retries = 0
        self._next_status = self._shown = 0
        self._counts_then: tuple[int, ...] = ()

    def run(self, relay: Connection) -> None:
        """Watch until the relay is gone and all that it left is taken."""
        asked = False
        while True:
            rest = self.look()
            try:
                if asked and not self._reader.waiting:
                    relay.send_bytes(self._goodbyes())
                    asked = False
                if relay.poll(rest):
                    said = relay.recv_bytes()
                    asked = said == FAREWELL
                    self._advice = self._advice if asked else said.decode()
            except (EOFError, OSError):
                break
        until = time.monotonic() + _CATCHES_UP_WITHIN
        while self._reader.waiting and time.monotonic() < until:
            self.look()
        self._finish()

    def look(self) -> float:
        """Take what the relay has written: record all of it, then decode, show and judge for a spell.

        Returns:
            Seconds that others may have for themselves before the next look.
        """
        began = time.monotonic()
        if self._scribe is not None:
            self._scribe.write()
        is_busy = self._decode()
        self._look_around()
        took = time.monotonic() - began
        return min(max(TICK, took * _REST), _LONGEST_REST) if not is_busy or self._may_rest() else 0

    def _may_rest(self) -> bool:
        """Tell whether what was not decoded can wait: more comes, there is room and time, and no haste."""
        reader, before = self._reader, self._written
        self._written = reader.written
        if self._written == before or reader.haste >= Haste.ALL or time.time_ns() - self._seen > _LATEST:
            return False
        return reader.share < _MAY_WAIT

    def _decode(self) -> bool:
        """Decode; tell whether the spell was too short."""
        until = time.monotonic() + _SPELL
        recorded = None if self._scribe is None else self._scribe.reader.place
        while records := self._reader.take(_AT_ONCE, recorded):
            self._take(records)
            if time.monotonic() >= until:
                return True
        return False

    def _take(self, records: list[Record]) -> None:
        lines: list[str | bytes] = []
        for count, (seen, note) in enumerate(self._witness.observe(records)):
            lines += self._view.frame(seen, note)
            self._diagnosis.take_observation(seen)
            settled = self._tracker.observe(seen)
            if settled:
                lines += self._settled(settled)
            if count % _FEW == 0:
                self._pause()
        self._screen.show(lines)
        self._seen = records[-1].left or records[-1].came
        self._delays.add(records)
        self._tell(records)
        for conversation, why in self._witness.gone():
            self._part_from(conversation, printable(why))

    def _tell(self, records: Iterable[Record]) -> None:
        for record in records:
            if record.kind is Kind.TOLD:
                self._screen.tell(printable(record.data.decode("utf-8", "replace")))

    def _part_from(self, conversation: Conversation, why: str) -> None:
        """Settle the calls of a client that has gone, tell what it left behind, and forget it."""
        self._screen.show(self._settled(self._tracker.forget(conversation)))
        left = self._farewells.forget(conversation)
        self._handles.forget(conversation)
        self._diagnosis.forget(conversation)
        self._view.forget(conversation)
        if left and not (self._bade_farewell and conversation.transport is Transport.UDP):  # that is told
            self._screen.tell(f"{conversation.client} is gone ({why}) while {left}")

    def _settled(self, settled: Iterable[Settled]) -> list[str | bytes]:
        lines: list[str | bytes] = []
        for item in settled:
            subject = None
            if isinstance(item, Exchange):
                self._calls += 1
                self._retries += item.retries
                subject = self._handles.follow(item)
                self._farewells.follow(item)
            self._diagnosis.take(item)
            lines += self._view.call(item, subject)
        return lines

    def _look_around(self) -> None:
        """Do what is due whether or not anything passes."""
        now = time.time_ns()
        color = self._colors
        if not self._reader.waiting:
            self._screen.show(self._settled(self._tracker.expire(now - _MARGIN)))
            heard = self._witness.heard
            sending = ((each, heard[each]) for each in self._farewells.in_slave_mode() if each in heard)
            for sentence in self._vigil.look(sending, now - _MARGIN):
                self._screen.tell(
                    f"{color.problem}{IN_SLAVE_MODE.severity}{color.reset} {IN_SLAVE_MODE.id}: {sentence}"
                )
        for finding in self._diagnosis.news():
            head = f"{color.problem}{finding.severity}{color.reset} {finding.rule}"
            self._screen.tell(f"{head}: {printable(finding.sentence)}")
        warning = self._delays.warning()
        if warning:
            self._screen.tell("; ".join(filter(None, (warning, self._advice))))
        if now >= self._next_status:
            self._status(now)

    def _status(self, now: int) -> None:
        """Tell how it goes: the relay, for whoever asks it, and the terminal."""
        for place, figure in enumerate(self._delays.figures()):
            self._reader.figures[place] = figure
        self._next_status = now + _STATUS_EVERY
        if self._screen.has_status:
            self._show_status(now)

    def _show_status(self, now: int) -> None:
        counts = tuple(self._reader.counts)
        seconds = (now - self._shown) / 1e9
        parts = [counted(self._calls, "call"), f"{self._retries} retries"]
        parts += [rates(counts, self._counts_then, seconds), self._delays.brief(), *losses(counts)]
        self._screen.status(" · ".join(part for part in parts if part))
        self._counts_then, self._shown = counts, now

    def _goodbyes(self) -> bytes:
        """Return how the relay can end the sessions that are open: JSON, client and frames in hex."""
        # What was answered is over, though a late retry of it might still come.
        self._screen.show(self._settled(self._tracker.expire(time.time_ns() + RETRY_WITHIN_NS)))
        self._bade_farewell = True
        numbers = self._witness.numbers
        goodbyes = []
        for farewell in self._farewells.of_all():
            number = numbers.get(farewell.conversation)
            if number is not None:
                goodbyes.append((number, farewell.state, [each.hex() for each in farewell.requests]))
        return json.dumps(goodbyes).encode()

    def _skip(self) -> None:
        """Pass over what there is no time for, but for what the relay tells."""
        if self._reader.waiting:
            self._screen.tell("what passed last was not looked at, as it takes too long; a recording has it")
        while self._reader.waiting:
            self._tell(self._reader.take())

    def _finish(self) -> None:
        """Settle what is open and sum up."""
        while self._scribe is not None and self._scribe.reader.waiting:
            self._scribe.write()
        self._skip()
        self._screen.show(self._settled(self._tracker.close()))
        findings = self._diagnosis.finish()
        tell, counts = self._screen.tell, tuple(self._reader.counts)
        tell(
            f"{counted(self._calls, 'call')}, {counted(self._retries, 'retry', 'retries')}; {totals(counts)}"
        )
        for line in (*losses(counts), *self._delays.lines()):
            tell(line)
        if self._witness.count:
            width = shutil.get_terminal_size().columns
            for line in FindingsRenderer(self._colors, width).lines(findings, self._diagnosis.seen):
                tell(line)
