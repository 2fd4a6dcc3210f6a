"""The process that searches: it goes through a journal with a filter and tells what fits.

Run as ``python -m bcapscope.tui.traffic.searching FOLDER``; what is asked comes through standard input, what
was found goes to standard output. A new ask ends the one before; one that was answered goes on with what is
added.
"""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
import time
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, cast

from bcapscope.capture.callbook import Callbook
from bcapscope.capture.journal import Journal
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.fields import RecordKind
from bcapscope.traffic.filters import compile_filter
from bcapscope.traffic.getters import CALL_GETTERS, FRAME_GETTERS
from bcapscope.tui.traffic.report import Ask, Matches, receive, send, step_back

TELL = 0.05
"""Seconds between two moments at which the screen is told."""

_BATCH = 128
"""Rows between two looks whether something else is asked: some milliseconds."""


class Searching:
    """Answers one ask at a time, the latest."""

    def __init__(self, folder: Path, answers: BinaryIO) -> None:
        """Take the folder of the journal, and where answers go."""
        self._answers = answers
        self._journal = Journal(folder)
        self._calls = Callbook(folder, self._journal)
        self._asked: Ask | None = None
        self._new = threading.Event()

    def listen(self, asks: io.RawIOBase) -> None:
        """Take what is asked until nothing more is; then end the process."""
        for ask in receive(asks, Ask):
            self._asked = ask
            self._new.set()
        os._exit(0)

    def run(self) -> None:
        """Answer for ever."""
        while True:
            ask = self._asked
            if ask is not None and ask.expression:
                self._answer(ask)
            else:
                self._new.wait()
            self._new.clear()

    def _answer(self, ask: Ask) -> None:
        """Go through what there is, then through what is added, until something else is asked."""
        fits, size = self._frames(ask) if ask.kind == RecordKind.FRAME else self._those(ask)
        searched, rows, told = 0, array("I"), 0.0
        told_at = -1
        while self._asked is ask:  # which `_new` may tell only after that has been seen
            there = size()
            stop = min(there, searched + _BATCH)
            rows.extend(row for row in range(searched + 1, stop + 1) if fits(row))
            searched = stop
            now = time.monotonic()
            if now - told >= TELL and searched != told_at:
                send(self._answers, Matches(ask.generation, rows.tobytes(), searched))
                rows, told, told_at = array("I"), now, searched
            if searched == there and self._new.wait(TELL):
                self._new.clear()

    def _frames(self, ask: Ask) -> tuple[Callable[[int], bool], Callable[[], int]]:
        test = compile_filter(ask.expression, RecordKind.FRAME).bind(FRAME_GETTERS)
        told = self._journal.told
        return lambda row: test(told(row)), self._journal.refresh

    def _those(self, ask: Ask) -> tuple[Callable[[int], bool], Callable[[], int]]:
        test = compile_filter(ask.expression, RecordKind.CALL).bind(CALL_GETTERS)

        def fits(row: int) -> bool:
            settled = self._calls.row(row - 1).settled
            return isinstance(settled, Exchange) and test(settled)

        return fits, self._calls.refresh


def main() -> None:
    """Search as standard input says."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is a key of the screen
    step_back()
    searching = Searching(Path(sys.argv[1]), cast(BinaryIO, sys.stdout.buffer))
    asks = io.FileIO(0, closefd=False)
    threading.Thread(target=searching.listen, args=(asks,), daemon=True, name="asks").start()
    try:
        searching.run()
    except BrokenPipeError:  # the screen is gone
        os._exit(0)


if __name__ == "__main__":
    main()
