"""The action log lists what bcapscope's own clients send to a controller. Each line is a JSON object.

A separate thread writes the lines, so a slow disk never delays a stop. A call that needs arming waits until
its line is written, but no longer than `LINE_TIMEOUT`. If the log cannot be written, bcapscope shows a
warning and still makes the calls.
"""

from __future__ import annotations

import errno
import json
import math
import os
import queue
import re
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import NamedTuple, TypeAlias

import platformdirs

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.protocol.codec.frame import SMALLEST_FRAME, Frame, Malformed
from bcapscope.protocol.codec.variant import Value, Variant, vt_name
from bcapscope.protocol.guard import needs_arming
from bcapscope.protocol.tables.command_catalogue import call_name
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.traffic.bounded_dict import BoundedDict
from bcapscope.traffic.call_kind import call_kind_of
from bcapscope.traffic.observation import Conversation, Transport


class LogFiles:
    """Appends lines to ``actions-<date>.jsonl``, then ``actions-<date>.2.jsonl`` and so on.

    Attributes:
        path: Path of the file to which the last line was written; before the first line, path of the folder.
        max_file_size: Size in bytes at which a file is full: the next line begins the day's next file.
        max_total_size: Size limit of all files together, in bytes. Before a new file begins, the oldest files
            are deleted until `max_file_size` more bytes fit.
    """

    max_file_size = 16 << 20
    max_total_size = 128 << 20

    def __init__(self, folder: Path) -> None:
        self.path = folder
        self._folder = folder
        self._is_torn = False

    def append(self, line: bytes) -> None:
        """Append a line with a single write, because other processes append to the same file. Raises OSError
        if the line was not written completely.
        """
        self.path = self._current(datetime.now().strftime("%Y-%m-%d"))
        data = b"\n" + line if self._is_torn else line
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_BINARY", 0)
        descriptor = os.open(self.path, flags, 0o644)
        try:
            written = os.write(descriptor, data)
        finally:
            os.close(descriptor)
        self._is_torn = written < len(data)
        if self._is_torn:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _current(self, day: str) -> Path:
        self._folder.mkdir(parents=True, exist_ok=True)  # a user may delete the folder while bcapscope runs
        number = max(map(_number_of, self._folder.glob(f"actions-{day}*")), default=1)
        path = self._numbered_path(day, number)
        with suppress(FileNotFoundError):
            if path.stat().st_size < self.max_file_size:
                return path
            path = self._numbered_path(day, number + 1)
        self._delete_oldest()
        return path

    def _numbered_path(self, day: str, number: int) -> Path:
        return self._folder / f"actions-{day}{f'.{number}' if number > 1 else ''}.jsonl"

    def _delete_oldest(self) -> None:
        with suppress(OSError):
            found = [(path.stat(), path) for path in self._folder.glob("actions-*.jsonl")]
            left = sum(stat.st_size for stat, _ in found) + self.max_file_size
            for stat, path in sorted(found, key=lambda each: (each[0].st_mtime_ns, _number_of(each[1]))):
                if left <= self.max_total_size:
                    return
                path.unlink()
                left -= stat.st_size


def _number_of(path: Path) -> int:
    found = re.search(r"\.(\d{1,6})\.jsonl$", path.name)
    return int(found[1]) if found else 1


LINE_TIMEOUT = 0.25
"""Maximum time in s by which the log delays a call that needs arming."""

CLOSE_TIMEOUT = 2.0
"""Maximum time in s that `ActionLog.close` waits for room in the queue, and then for unwritten lines."""

MAX_WAITING = 4096
"""Maximum number of lines that wait to be written, and of requests that wait for a reply."""

_MAX_TEXT, _MAX_VALUES, _MAX_BYTES = 512, 128, 1024

ErrorCallback: TypeAlias = Callable[[Path, OSError], None]
"""Gets the path of a file that cannot be written, and the reason. Any thread may call the function."""


class LoggedConnection(NamedTuple):
    """A connection to a controller over "udp" or "tcp". `client_port` is 0 if it is unknown."""

    host: str
    port: int
    transport: str
    client_port: int = 0

    @classmethod
    def of_target(cls, target: ControllerTarget) -> LoggedConnection:
        """The host is the text that the user typed."""
        transport = Transport.TCP if target.tcp else Transport.UDP
        return cls(target.host, target.port, transport.value)

    @classmethod
    def of_conversation(cls, conversation: Conversation) -> LoggedConnection:
        server = conversation.server
        return cls(server.host, server.port, conversation.transport.value, conversation.client.port)


def default_folder() -> Path:
    return platformdirs.user_log_path("bcapscope", appauthor=False)


class ActionLog:
    """Writes the action log. Any thread may call the methods of an `ActionLog`."""

    def __init__(self, folder: Path, program: str, on_error: ErrorCallback) -> None:
        """`program` is the name of the program that sends the requests, such as "call". `on_error` is called
        for the first of successive failures to write.
        """
        self.folder = folder
        self._program = program
        self._on_error = on_error
        self._files = LogFiles(folder)
        self._lock = threading.Lock()
        self._logged_requests: BoundedDict[tuple[LoggedConnection, int], str] = BoundedDict(MAX_WAITING)
        self._lines: queue.Queue[tuple[bytes, threading.Event] | None] = queue.Queue(MAX_WAITING)
        self._thread: threading.Thread | None = None
        self._broken = self._stuck = False

    def log_request(
        self,
        connection: LoggedConnection,
        item: Frame | Malformed,
        time: int,
        who: str,
        is_logged: bool = True,
    ) -> None:
        """Log a request that `who` sent. If `is_logged` is False, neither the request nor its reply is
        logged. `time` is in ns since 1970.
        """
        if isinstance(item, Malformed):
            self._write(time, connection, {"who": who, "sent": None, **_hex(item.raw)}, True)
            return
        key, name = (connection, item.serial), _shortened(call_name(item.code, item.variants))
        with self._lock:
            self._logged_requests.pop(key, None)
            if not is_logged:
                return
            self._logged_requests[key] = name
        fields = {
            "who": who,
            "serial": item.serial,
            "sent": name,
            "arguments": _elements_json(item.variants, [_MAX_VALUES]),
            **_hex(item.raw),
        }
        self._write(time, connection, fields, needs_arming(item.code, item.variants))

    def log_reply(self, connection: LoggedConnection, item: Frame | Malformed, time: int) -> None:
        if isinstance(item, Malformed):
            return
        with self._lock:
            name = self._logged_requests.get((connection, item.serial))
        if name is not None:
            fields = {"serial": item.serial, "call": name, "received": hresult_name(item.code)}
            self._write(time, connection, {**fields, **_hex(item.raw)}, False)

    def log_set_points(self, connection: LoggedConnection, count: int, time: int, who: str) -> None:
        self._write(
            time, connection, {"who": who, "sent": "Robot_Execute slvMove", "set_points": count}, False
        )

    def close(self) -> None:
        """Wait until all lines are written, but at most 2 * `CLOSE_TIMEOUT`. A line that is logged after
        `close` starts a new writing thread.
        """
        with self._lock:
            thread, self._thread = self._thread, None
        if thread is None:
            return
        try:
            self._lines.put(None, timeout=CLOSE_TIMEOUT)
        except queue.Full:
            return self._report_stuck()
        thread.join(CLOSE_TIMEOUT)
        if thread.is_alive():
            self._report_stuck()

    def _write(
        self, time: int, connection: LoggedConnection, fields: dict[str, object], wait_until_written: bool
    ) -> None:
        place = {"host": connection.host, "port": connection.port, "transport": connection.transport}
        if connection.client_port:
            place["client_port"] = connection.client_port
        program = {"program": self._program, "pid": os.getpid()}
        local_time = datetime.fromtimestamp(time / 1e9).astimezone().isoformat(timespec="microseconds")
        line = _json({"time": local_time, **program, **place, **fields})
        written = threading.Event()
        with self._lock:
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="action log", daemon=True)
                self._thread.start()
        try:
            self._lines.put_nowait((line, written))
        except queue.Full:
            return self._report_stuck()
        if wait_until_written and not self._stuck and not written.wait(LINE_TIMEOUT):
            self._report_stuck()

    def _report_stuck(self) -> None:
        if not self._stuck:
            self._stuck = True
            self._on_error(self._files.path, OSError(0, "the disk does not answer"))

    def _run(self) -> None:
        while (waiting := self._lines.get()) is not None:
            line, written = waiting
            try:
                self._files.append(line)
            except OSError as error:
                if not self._broken:
                    self._broken = True
                    self._on_error(self._files.path, error)
            else:
                self._broken = self._stuck = False
            written.set()


def _json(fields: dict[str, object]) -> bytes:
    """Return a line of JSON that contains only printable ASCII characters; all others are escaped."""
    text = json.dumps(fields, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("\x7f", "\\u007f").encode("ascii") + b"\n"


def _hex(raw: bytes) -> dict[str, object]:
    shown: dict[str, object] = {"hex": raw[:_MAX_BYTES].hex()}
    return shown if len(raw) <= _MAX_BYTES else {**shown, "bytes": len(raw)}


def _value_json(value: Value, left: list[int]) -> object:
    """Convert a value to JSON types. `left[0]` is the number of values that still fit in the line."""
    left[0] -= 1
    if isinstance(value, Variant):
        return {"type": vt_name(value.vt), "value": _value_json(value.value, left)}
    if isinstance(value, tuple):
        return _elements_json(value, left)
    if isinstance(value, bytes):
        return _shortened(value.hex())
    if isinstance(value, str):
        return _shortened(value)
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _elements_json(values: Sequence[Value], left: list[int]) -> list[object]:
    shown: list[object] = []
    for element in values:
        if left[0] <= 0:
            return [*shown, f"{len(values) - len(shown)} more"]
        shown.append(_value_json(element, left))
    return shown


def _shortened(text: str) -> str:
    more = len(text) - _MAX_TEXT
    return text if more <= 0 else f"{text[:_MAX_TEXT]}, {more} more"


_WHO = "user"
_FUNCTION_ID = 9


class ArmedCallLogger:
    """Receives all frames of a connection, and logs the calls that need arming.

    The first set point of a series is logged like any other call. One further line gives the number of all
    later set points. A set point that is sent again before a reply arrives counts as a retry.
    """

    def __init__(self, log: ActionLog, connection: LoggedConnection) -> None:
        self._log = log
        self._connection = connection
        self._set_points = 0
        self._unanswered = b""

    def add_frame(self, sent: bool, raw: bytes, timestamp: int) -> None:
        """Process a frame that was sent or received; `timestamp` is ns since 1970-01-01 UTC."""
        if len(raw) < SMALLEST_FRAME:
            return
        frame = Frame(raw)
        if not sent:
            self._unanswered = b""
            self._log.log_reply(self._connection, frame, timestamp)
            return
        if (call_kind_of(frame).command or "").casefold() == "slvmove":
            is_retry, self._unanswered = raw[_FUNCTION_ID:] == self._unanswered, raw[_FUNCTION_ID:]
            self._set_points += not is_retry
            self._log.log_request(
                self._connection, frame, timestamp, _WHO, is_logged=self._set_points == 1 and not is_retry
            )
            return
        wanted = needs_arming(frame.code, frame.variants)
        if wanted:
            self.end_set_points(timestamp)
        self._log.log_request(self._connection, frame, timestamp, _WHO, wanted)

    def add_set_points(self, count: int) -> None:
        """Add `count` set points that were sent, but not passed to `add_frame`."""
        self._set_points += count

    def end_set_points(self, timestamp: int | None = None) -> None:
        """Log how many set points were sent since the last line about set points. Without set points, log
        nothing. `timestamp` is the time of the line in ns; None means now.
        """
        count, self._set_points = self._set_points, 0
        if count:
            self._log.log_set_points(
                self._connection, count, time.time_ns() if timestamp is None else timestamp, _WHO
            )
