"""A simulator and a proxy before it, both run as users run them."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from tests.cli.test_sim import simulator

PATIENCE = 60.0
"""Seconds that anything may take on a busy machine."""


class Proxied:
    """A proxy at work.

    Attributes:
        port: where clients go.
        control: what is behind `proxy ctl`; "" without.
        said: the lines of both outputs, once it has ended.
    """

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.port = 0
        self.control = ""
        self.said: list[str] = []
        self._process = process
        self._ready = threading.Event()
        self._readers = [self._reader(process.stdout), self._reader(process.stderr)]
        if not self._ready.wait(PATIENCE):
            raise AssertionError(self.said)

    def end(self) -> str:
        """Interrupt it; give all that it said."""
        self._process.send_signal(signal.SIGINT)
        self._process.wait(PATIENCE)
        for reader in self._readers:
            reader.join(PATIENCE)
        return "\n".join(self.said)

    def kill(self) -> None:
        """Kill it."""
        self._process.kill()
        self._process.wait(PATIENCE)

    def _reader(self, pipe: IO[str] | None) -> threading.Thread:
        assert pipe is not None
        thread = threading.Thread(target=self._read, args=(pipe,), daemon=True)
        thread.start()
        return thread

    def _read(self, pipe: IO[str]) -> None:
        for line in pipe:
            self.said.append(line.rstrip("\n"))
            if control := re.search(r"control: bcapscope proxy ctl (\S+)", line):
                self.control = control[1]
            if listening := re.match(r"127\.0\.0\.1:(\d+) .*> 127\.0\.0\.1:", line):
                self.port = int(listening[1])
                self._ready.set()
        self._ready.set()


@contextmanager
def proxied(*words: str | Path, sim: Sequence[str] = ("-q",)) -> Iterator[Proxied]:
    """Run both on free ports for the length of a block."""
    with simulator(*sim) as (_, port):
        target = f"127.0.0.1:{port}"
        argv = [sys.executable, "-m", "bcapscope", "proxy", "--listen", "127.0.0.1:0", "--to", target]
        pipe = subprocess.PIPE
        with subprocess.Popen([*argv, *map(str, words)], stdout=pipe, stderr=pipe, text=True) as process:
            try:
                yield Proxied(process)
            finally:
                process.kill()
