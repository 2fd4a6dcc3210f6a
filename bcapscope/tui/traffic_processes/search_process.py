"""The search process, which applies a filter to frames or calls. The argument is the journal's folder.
Requests arrive on standard input; matches go to standard output. A new request ends the previous search.
After the last row, a search waits for new rows and examines them.
"""

from __future__ import annotations

import io
import os
import sys
import threading
import time
from array import array
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from queue import Empty, Queue
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
    begin_process,
    receive_messages,
    send_message,
)

REPORT_INTERVAL = 0.05
"""Seconds between two reports."""

_BATCH = 128  # rows between two checks for a new request; 128 rows take some milliseconds


class TrafficSearch:
    def __init__(self, folder: Path, answers: BinaryIO) -> None:
        self._answers = answers
        self._journal = ObservationStore(folder)
        self._calls = CallStore(folder, self._journal)
        self.requests: Queue[SearchRequest] = Queue()

    def read_requests(self, requests: io.RawIOBase) -> None:
        """Read requests until the input stream ends, then end the process."""
        for request in receive_messages(requests, SearchRequest):
            self.requests.put(request)
        os._exit(0)

    def run(self) -> None:
        request = self.requests.get()
        while True:
            request = self._answer_request(request) if request.expression else self.requests.get()

    def _answer_request(self, request: SearchRequest) -> SearchRequest:
        """Search the existing and new rows until the next request arrives; return that request."""
        is_frame = request.kind == RecordKind.FRAME
        fits, count_rows = self._frame_search(request) if is_frame else self._call_search(request)
        rows, searched, reported, reported_at = array("I"), 0, 0.0, -1
        while self.requests.empty():
            row_count = count_rows()
            stop = min(row_count, searched + _BATCH)
            rows.extend(row for row in range(searched + 1, stop + 1) if fits(row))
            searched = stop
            now = time.monotonic()
            if now - reported >= REPORT_INTERVAL and searched != reported_at:
                send_message(self._answers, SearchMatches(request.generation, rows.tobytes(), searched))
                rows, reported, reported_at = array("I"), now, searched
            if searched == row_count:
                with suppress(Empty):
                    return self.requests.get(timeout=REPORT_INTERVAL)
        return self.requests.get()

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
    begin_process()
    searching = TrafficSearch(Path(sys.argv[1]), cast(BinaryIO, sys.stdout.buffer))
    requests = io.FileIO(0, closefd=False)
    threading.Thread(target=searching.read_requests, args=(requests,), daemon=True, name="requests").start()
    try:
        searching.run()
    except BrokenPipeError:  # the screen has gone
        os._exit(0)


if __name__ == "__main__":
    main()
