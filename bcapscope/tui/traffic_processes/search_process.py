"""The process that searches: it goes through a journal with a filter and tells what fits.

Run as ``python -m bcapscope.tui.traffic_processes.search_process FOLDER``; what is asked comes through
standard input, what was found goes to standard output. A new ask ends the one before; one that was answered
goes on with what is added.
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

from bcapscope.capture.call_store import CallStore
from bcapscope.capture.observation_store import ObservationStore
from bcapscope.traffic.call import Call
from bcapscope.traffic.filter.compiler import compile_filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.filter.getters import CALL_GETTERS, FRAME_GETTERS
from bcapscope.tui.traffic_processes.process_messages import (
    SearchMatches,
    SearchRequest,
    lower_priority,
    receive_messages,
    send_message,
)

REPORT_INTERVAL = 0.05
"""Seconds between two moments at which the screen is told."""

_BATCH = 128
"""Rows between two looks whether something else is asked: some milliseconds."""


class TrafficSearch:
    """Answers one ask at a time, the latest."""

    def __init__(self, folder: Path, answers: BinaryIO) -> None:
        """Take the folder of the journal, and where answers go."""
        self._answers = answers
        self._journal = ObservationStore(folder)
        self._calls = CallStore(folder, self._journal)
        self._latest_request: SearchRequest | None = None
        self._request_arrived = threading.Event()

    def read_requests(self, requests: io.RawIOBase) -> None:
        """Take what is asked until nothing more is; then end the process."""
        for ask in receive_messages(requests, SearchRequest):
            self._latest_request = ask
            self._request_arrived.set()
        os._exit(0)

    def run(self) -> None:
        """Answer for ever."""
        while True:
            ask = self._latest_request
            if ask is not None and ask.expression:
                self._answer_request(ask)
            else:
                self._request_arrived.wait()
            self._request_arrived.clear()

    def _answer_request(self, request: SearchRequest) -> None:
        """Go through what there is, then through what is added, until something else is asked."""
        fits, size = (
            self._frame_search(request) if request.kind == RecordKind.FRAME else self._call_search(request)
        )
        searched, rows, told = 0, array("I"), 0.0
        told_at = -1
        while (
            self._latest_request is request
        ):  # which `_request_arrived` may tell only after that has been seen
            there = size()
            stop = min(there, searched + _BATCH)
            rows.extend(row for row in range(searched + 1, stop + 1) if fits(row))
            searched = stop
            now = time.monotonic()
            if now - told >= REPORT_INTERVAL and searched != told_at:
                send_message(self._answers, SearchMatches(request.generation, rows.tobytes(), searched))
                rows, told, told_at = array("I"), now, searched
            if searched == there and self._request_arrived.wait(REPORT_INTERVAL):
                self._request_arrived.clear()

    def _frame_search(self, request: SearchRequest) -> tuple[Callable[[int], bool], Callable[[], int]]:
        test = compile_filter(request.expression, RecordKind.FRAME).bind(FRAME_GETTERS)
        told = self._journal.read_frame
        return lambda row: test(told(row)), self._journal.refresh

    def _call_search(self, request: SearchRequest) -> tuple[Callable[[int], bool], Callable[[], int]]:
        test = compile_filter(request.expression, RecordKind.CALL).bind(CALL_GETTERS)

        def fits(row: int) -> bool:
            settled = self._calls.read_call(row - 1).settled
            return isinstance(settled, Call) and test(settled)

        return fits, self._calls.refresh


def main() -> None:
    """Search as standard input says."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is a key of the screen
    lower_priority()
    searching = TrafficSearch(Path(sys.argv[1]), cast(BinaryIO, sys.stdout.buffer))
    asks = io.FileIO(0, closefd=False)
    threading.Thread(target=searching.read_requests, args=(asks,), daemon=True, name="asks").start()
    try:
        searching.run()
    except BrokenPipeError:  # the screen is gone
        os._exit(0)


if __name__ == "__main__":
    main()
