"""The audit log: everything that was sent, a JSON object a line, written before anybody could lose it.

One file a day, only ever appended to. What the controller answered stands in it as well, so that it tells
both what was asked and what became of it. Only what the screen reads by itself, again and again, is left out.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

import orjson
import platformdirs

from bcapscope.protocol.effects import Effect
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.functions import function_name
from bcapscope.protocol.guard import request_effect
from bcapscope.protocol.hresult import hresult_name
from bcapscope.render.moment import utc_text
from bcapscope.render.record import json_text
from bcapscope.traffic.observation import Direction, Observation
from bcapscope.traffic.question import question_of
from bcapscope.tui.desk.record import Who, cause

MOST_ASKED = 4096
"""Requests whose answers are waited for."""


def default_folder() -> Path:
    """Say where the audit log lies on this platform."""
    return platformdirs.user_log_path("bcapscope", appauthor=False)


class Audit:
    """Writes the log.

    Attributes:
        folder: where the files are.
    """

    def __init__(self, folder: Path, trouble: Callable[[str], None]) -> None:
        """Write into `folder`; `trouble` is told once why it cannot be done, and calls go on without."""
        self.folder = folder
        self._trouble = trouble
        self._file: BinaryIO | None = None
        self._path: Path | None = None
        self._broken = self._is_ended = False
        self._lock = threading.Lock()
        self._asked: dict[tuple[int, int], Who] = {}

    def take(self, seen: Observation, who: Who) -> None:
        """Write down a packet; from any thread."""
        with self._lock:
            if not self._broken and self._is_wanted(seen, who):
                self._write(seen, self._asked.get(_key(seen), who))
                if self._is_ended:
                    self._shut()

    def _is_wanted(self, seen: Observation, who: Who) -> bool:
        """Tell whether a packet is more than the screen's own reading, or answers what is."""
        item = seen.item
        if not isinstance(item, Frame):
            return True
        key = _key(seen)
        if seen.flow.direction is Direction.RESPONSE:
            return key in self._asked
        arguments = tuple(each.variant for each in item.arguments)
        if who is not Who.USER and request_effect(item.code, arguments) is Effect.READS:
            self._asked.pop(key, None)
            return False
        self._asked[key] = who
        if len(self._asked) > MOST_ASKED:
            del self._asked[next(iter(self._asked))]
        return True

    def _write(self, seen: Observation, who: Who) -> None:
        try:
            self._open(seen.time).write(_line(seen, who))
        except OSError as error:
            self._broken = True
            self._shut()
            self._trouble(f"{self._path or self.folder}: {cause(error)}")

    def close(self) -> None:
        """Close the file; what a line that ends late still sends is written, and it is closed again."""
        with self._lock:
            self._is_ended = True
            self._shut()

    def _shut(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def path(self, time: int) -> Path:
        """Say which file a moment's packets go to."""
        return self.folder / f"sent-{datetime.fromtimestamp(time // 1_000_000_000, UTC):%Y-%m-%d}.jsonl"

    def _open(self, time: int) -> BinaryIO:
        path = self.path(time)
        if self._file is None or path != self._path:
            self._shut()
            self.folder.mkdir(parents=True, exist_ok=True)
            self._path = path
            self._file = path.open("ab", buffering=0)
        return self._file


def _key(seen: Observation) -> tuple[int, int]:
    """Return what a request and its answer have in common; bytes that are no frame have it with none."""
    return id(seen.flow.conversation), seen.item.serial if isinstance(seen.item, Frame) else -1


def _line(seen: Observation, who: Who) -> bytes:
    item, sent = seen.item, seen.flow.direction is Direction.REQUEST
    call = result = None
    if isinstance(item, Frame):
        if sent:
            question = question_of(item)
            call = function_name(question.function_id)
            call += f" {question.command}" if question.command else ""
        else:
            result = hresult_name(item.code)
    pairs: tuple[tuple[str, bytes], ...] = (
        ("time", orjson.dumps(utc_text(seen.time))),
        ("who", orjson.dumps(who.value)),
        ("peer", json_text(f"{seen.flow.conversation.server} {seen.flow.conversation.transport}")),
        ("sent" if sent else "received", json_text(call if sent else result)),
        ("hex", orjson.dumps(item.raw.hex())),
    )
    return b"{" + b",".join(b'"%b":%b' % (key.encode("ascii"), value) for key, value in pairs) + b"}\n"
