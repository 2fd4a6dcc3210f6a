"""The action log: what bcapscope's own clients sent to a controller, one JSON object per line.

`call`, `replay`, `play` and the Tester write the same lines into the same files. A thread of its own writes
them, so that no disk holds up a stop. A call that needs arming waits for its line before it is sent, but not
for long: an operator expects a warning when the log fails, not a robot that ignores commands.
"""

from __future__ import annotations

import json
import math
import os
import queue
import threading
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import NamedTuple, TypeAlias

import platformdirs

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.client.log_files import LogFiles
from bcapscope.protocol.codec.frame import Frame, Malformed
from bcapscope.protocol.codec.variant import Value, Variant, vt_name
from bcapscope.protocol.guard import needs_arming
from bcapscope.protocol.tables.command_catalogue import call_name
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.traffic.observation import Conversation, Transport

LINE_TIMEOUT = 0.25
"""Seconds that a call which needs arming waits for its line."""

CLOSE_TIMEOUT = 2.0
"""Seconds that `ActionLog.close` waits for the lines that are still to be written."""

MAX_WAITING = 4096
"""Lines that wait for the disk, and requests that wait for a reply; further ones are lost."""

_MAX_TEXT, _MAX_VALUES, _MAX_BYTES = 512, 128, 1024

ErrorCallback: TypeAlias = Callable[[Path, OSError], None]
"""Is called, from any thread, with the file that cannot be written and the reason."""


class LoggedConnection(NamedTuple):
    """A connection to a controller, as the log names it.

    Attributes:
        host: name or address.
        port: of the controller.
        transport: "udp" or "tcp".
        client_port: our own; 0 where it is not known.
    """

    host: str
    port: int
    transport: str
    client_port: int = 0

    @classmethod
    def of_target(cls, target: ControllerTarget, client_port: int = 0) -> LoggedConnection:
        """Name a connection by what the user typed."""
        transport = Transport.TCP if target.tcp else Transport.UDP
        return cls(target.host, target.port, transport.value, client_port)

    @classmethod
    def of_conversation(cls, conversation: Conversation) -> LoggedConnection:
        """Name a connection by its ends."""
        server = conversation.server
        return cls(server.host, server.port, conversation.transport.value, conversation.client.port)


def default_folder() -> Path:
    """Return where the action log is on this platform."""
    return platformdirs.user_log_path("bcapscope", appauthor=False)


class ActionLog:
    """Writes the log; all methods may be called from any thread.

    Attributes:
        folder: where the files are.
    """

    def __init__(self, folder: Path, program: str, on_error: ErrorCallback) -> None:
        """Prepare; nothing is created before the first line.

        Args:
            folder: for the files.
            program: that sends, such as "call".
            on_error: called when the log cannot be written; once until it can be written again.
        """
        self.folder = folder
        self._program = program
        self._on_error = on_error
        self._files = LogFiles(folder, "actions")
        self._lock = threading.Lock()
        self._logged_requests: dict[tuple[LoggedConnection, int], str] = {}
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
        """Write a request, and its reply when it comes.

        Args:
            connection: that it goes over.
            item: the request, or bytes that are no frame.
            time: ns since 1970-01-01 UTC.
            who: caller that made the request.
            is_logged: False for a request that is not to be logged.
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
            if len(self._logged_requests) > MAX_WAITING:
                del self._logged_requests[next(iter(self._logged_requests))]
        fields = {
            "who": who,
            "serial": item.serial,
            "sent": name,
            "arguments": _arguments_json(item.variants),
            **_hex(item.raw),
        }
        self._write(time, connection, fields, needs_arming(item.code, item.variants))

    def log_reply(self, connection: LoggedConnection, item: Frame | Malformed, time: int) -> None:
        """Write a reply, if its request was written."""
        if isinstance(item, Malformed):
            return
        with self._lock:
            name = self._logged_requests.get((connection, item.serial))
        if name is not None:
            fields = {"serial": item.serial, "call": name, "received": hresult_name(item.code)}
            self._write(time, connection, {**fields, **_hex(item.raw)}, False)

    def log_set_points(self, connection: LoggedConnection, count: int, time: int, who: str) -> None:
        """Write how many set points were sent in a row, one line for all."""
        self._write(
            time, connection, {"who": who, "sent": "Robot_Execute slvMove", "set_points": count}, False
        )

    def close(self) -> None:
        """Wait for the lines that are still to be written; later ones start a new thread."""
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
        line = _json({"time": _timestamp(time), **program, **place, **fields})
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


def _timestamp(time: int) -> str:
    """Write a moment as ISO 8601, local time with its distance from UTC."""
    return datetime.fromtimestamp(time / 1e9).astimezone().isoformat(timespec="microseconds")


def _json(fields: dict[str, object]) -> bytes:
    """Write a line in which every character that is not printable ASCII is escaped."""
    text = json.dumps(fields, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("\x7f", "\\u007f").encode("ascii") + b"\n"


def _hex(raw: bytes) -> dict[str, object]:
    """Show the first bytes, and how many there are if that is not all."""
    shown: dict[str, object] = {"hex": raw[:_MAX_BYTES].hex()}
    return shown if len(raw) <= _MAX_BYTES else {**shown, "bytes": len(raw)}


def _arguments_json(arguments: Sequence[Variant]) -> list[object]:
    left = [_MAX_VALUES]
    shown: list[object] = [_typed_json(argument, left) for argument in arguments[:_MAX_VALUES]]
    return shown + ([f"{len(arguments) - len(shown)} more"] if len(arguments) > len(shown) else [])


def _typed_json(variant: Variant, left: list[int]) -> object:
    return {"type": vt_name(variant.vt), "value": _value_json(variant.value, left)}


def _value_json(value: Value, left: list[int]) -> object:
    """Turn a value into what JSON has; `left` bounds the values of all arguments together."""
    left[0] -= 1
    if isinstance(value, Variant):
        return _typed_json(value, left)
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
