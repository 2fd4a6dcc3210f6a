"""The search process: applies a filter to the records of a journal, and reports the matches.

bcapscope runs it as ``python -m bcapscope.tui.traffic_processes.search_process FOLDER``. Search requests
arrive on standard input; matches go to standard output. A new request ends the previous search. A search that
has reached the last row continues when new rows arrive.
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
"""Seconds between two reports."""

_BATCH = 128
"""Number of rows between two checks for a new request; examining them takes some milliseconds."""


class TrafficSearch:
    """Runs one search at a time: the search that was requested last."""

    def __init__(self, folder: Path, answers: BinaryIO) -> None:
        """Open the journal in `folder`; write matches to `answers`."""
        self._answers = answers
        self._journal = ObservationStore(folder)
        self._calls = CallStore(folder, self._journal)
        self._latest_request: SearchRequest | None = None
        self._request_arrived = threading.Event()

    def read_requests(self, requests: io.RawIOBase) -> None:
        """Read requests until the input stream ends, then end the process."""
        for ask in receive_messages(requests, SearchRequest):
            self._latest_request = ask
            self._request_arrived.set()
        os._exit(0)

    def run(self) -> None:
        while True:
            ask = self._latest_request
            if ask is not None and ask.expression:
                self._answer_request(ask)
            else:
                self._request_arrived.wait()
            self._request_arrived.clear()

    def _answer_request(self, request: SearchRequest) -> None:
        """Search the existing rows, then new rows, until the screen sends another request."""
        is_frame = request.kind == RecordKind.FRAME
        fits, size = self._frame_search(request) if is_frame else self._call_search(request)
        searched, rows, reported = 0, array("I"), 0.0
        reported_at = -1
        while self._latest_request is request:  # `_request_arrived` may be set only later
            there = size()
            stop = min(there, searched + _BATCH)
            rows.extend(row for row in range(searched + 1, stop + 1) if fits(row))
            searched = stop
            now = time.monotonic()
            if now - reported >= REPORT_INTERVAL and searched != reported_at:
                send_message(self._answers, SearchMatches(request.generation, rows.tobytes(), searched))
                rows, reported, reported_at = array("I"), now, searched
            if searched == there and self._request_arrived.wait(REPORT_INTERVAL):
                self._request_arrived.clear()

    def _frame_search(self, request: SearchRequest) -> tuple[Callable[[int], bool], Callable[[], int]]:
        test = compile_filter(request.expression, RecordKind.FRAME).bind(FRAME_GETTERS, self._first_time)
        read_frame = self._journal.read_frame
        return lambda row: test(read_frame(row)), self._journal.refresh

    def _call_search(self, request: SearchRequest) -> tuple[Callable[[int], bool], Callable[[], int]]:
        test = compile_filter(request.expression, RecordKind.CALL).bind(CALL_GETTERS, self._first_time)

        def fits(row: int) -> bool:
            settled = self._calls.read_call(row - 1).settled
            return isinstance(settled, Call) and test(settled)

        return fits, self._calls.refresh

    def _first_time(self) -> int:
        return self._journal.time_of(1)


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the screen uses Ctrl-C as a key
    lower_priority()
    searching = TrafficSearch(Path(sys.argv[1]), cast(BinaryIO, sys.stdout.buffer))
    asks = io.FileIO(0, closefd=False)
    threading.Thread(target=searching.read_requests, args=(asks,), daemon=True, name="asks").start()
    try:
        searching.run()
    except BrokenPipeError:  # the screen has gone
        os._exit(0)


if __name__ == "__main__":
    main()
