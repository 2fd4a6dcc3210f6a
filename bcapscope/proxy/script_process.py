"""Start the process of the scripts, exchange messages with it, and end it when the proxy ends."""

from __future__ import annotations

import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from bcapscope.messages import Message
from bcapscope.messages.message import foreign_text
from bcapscope.messages.places import joined_clauses
from bcapscope.proxy.poller import READ, WRITE, DescriptorWatcher
from bcapscope.proxy.script_protocol import (
    FrameUnpacker,
    ScriptError,
    ScriptsLoaded,
    ScriptStatement,
    ScriptsUnusable,
    WireError,
)

if TYPE_CHECKING:
    from bcapscope.proxy.rule_policy import RulePolicy

DEFAULT_MEMORY_MB = 512
"""Default memory limit of the scripts' process in megabytes. Python needs 20 MB. NumPy with its threads needs
200 MB on a machine with 4 processors, and more with more processors.
"""

LOADS_WITHIN = 30.0
"""Time limit in seconds for loading the scripts."""

FINISHES_WITHIN = 3.0
"""Time limit in seconds for the scripts to handle the last messages and run the hook `done`."""

_POLL_INTERVAL = 0.05
_EXIT_DELAY = 0.05
_LONGEST_TRACE = 1 << 14
_EXITS_WITHIN = 1.0
_PLACE = re.compile(r'File "(.*)", line (\d+) in (.*)')
_START = (
    "import sys; sys.path[:] = {path!r}; sys.argv[:] = {argv!r}; "
    "from bcapscope.proxy.script_host import main; main(*{arguments!r})"
)


class ScriptProcess:
    """A process that runs the user's scripts, and the proxy's connection to it."""

    _rules: RulePolicy
    _relay: DescriptorWatcher
    _is_interrupted: Callable[[], bool]

    def __init__(
        self,
        paths: Sequence[str],
        megabytes: int = DEFAULT_MEMORY_MB,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start the process. If the system cannot start the process, raise a `ScriptError`. `clock`, in
        seconds, measures the time limits.
        """
        self.names = ", ".join(Path(path).name for path in paths)
        self._clock = clock
        self._files = {Path(path).name for path in paths}
        self._loads_until = clock() + LOADS_WITHIN
        self._backlog = bytearray()
        self._waits_to_write = False
        self._watcher: DescriptorWatcher | None = None
        self._traces: int | None = None
        try:
            with ExitStack() as opened:
                self._socket, other = socket.socketpair()
                opened.enter_context(self._socket)
                with other:
                    self._process = self._start(other, paths, megabytes)
                opened.pop_all()  # the start succeeded, so the socket remains open
        except OSError as error:
            reason = error.strerror or str(error)
            raise ScriptError(Message("script.no-process", names=self.names, reason=reason)) from None
        self._socket.setblocking(False)
        self._statements: FrameUnpacker[ScriptStatement] = FrameUnpacker(ScriptStatement)

    def _start(self, other: socket.socket, paths: Sequence[str], megabytes: int) -> subprocess.Popen[bytes]:
        def words(descriptor: int | None, traces: int | None) -> list[str]:
            arguments = descriptor, traces, os.getpid(), [*paths], megabytes
            code = _START.format(path=sys.path, argv=sys.argv, arguments=arguments)
            return [sys.executable, "-c", code]

        # on Windows, a new process can neither inherit a socket nor report which script line it executes
        if sys.platform == "win32":
            process = subprocess.Popen(words(None, None), stdin=subprocess.PIPE)
            assert process.stdin is not None
            with process.stdin:
                process.stdin.write(other.share(process.pid))
            return process
        self._traces, traces = os.pipe()
        os.set_blocking(self._traces, False)
        try:
            return subprocess.Popen(
                words(other.fileno(), traces),
                stdin=subprocess.DEVNULL,
                pass_fds=(other.fileno(), traces),
                start_new_session=True,  # Ctrl-C then reaches only the proxy, which ends the scripts
            )
        except OSError:
            self._close_traces()
            raise
        finally:
            os.close(traces)

    def load(self, seconds: float) -> bool:
        """Wait until the scripts are loaded, but at most `seconds`. Return whether the scripts are loaded.
        Call `attach` first. If a script fails to load or has no add-on, raise a `ScriptError`.
        """
        until = self._clock() + seconds
        try:
            while (statement := self._statements.next_frame()) is None:
                now = self._clock()
                if now >= until:
                    if now <= self._loads_until:
                        return False
                    self.locate()
                    raise self._load_error(
                        Message("script.slow-loading", names=self.names, seconds=f"{LOADS_WITHIN:g}")
                    )
                readable, _, _ = select.select([self._socket], [], [], until - now)
                if readable and (data := self.receive()) is not None:
                    if not data:
                        raise self._load_error(Message("script.ended-loading", names=self.names))
                    self._statements.feed_bytes(data)
            if isinstance(statement, ScriptsUnusable):
                raise ScriptError(statement.reason.message)
            if not isinstance(statement, ScriptsLoaded):
                raise WireError(Message("script.wire.answer"))
        except WireError as error:
            reason = Message("script.named-invalid", names=self.names, reason=error.message)
            raise ScriptError(reason) from None
        assert self._rules.scripts is not None
        self._rules.scripts.on_loaded(statement.hooks)
        self._watcher = self._relay
        self._relay.watch(self._socket.fileno(), self._on_ready)
        return True

    def _load_error(self, what: Message) -> ScriptError:
        """End the process, and return an error that says why its scripts cannot be used."""
        time.sleep(_EXIT_DELAY)  # the exit code and the reported script line may arrive late
        reason = joined_clauses((what, *self.end()))
        assert reason is not None
        return ScriptError(reason)

    def attach(self, rules: RulePolicy, relay: DescriptorWatcher, is_interrupted: Callable[[], bool]) -> None:
        """Connect the process to the relay and to the proxy's rules. `is_interrupted` returns True if a
        signal during the shutdown asks the proxy to end immediately.
        """
        self._rules = rules
        self._relay = relay
        self._is_interrupted = is_interrupted

    # `ScriptQueue` calls the following methods, which raise no exception. Only `finish` may block the caller.

    def send(self, frame: bytes) -> None:
        self._backlog += frame
        self._flush()

    def receive(self) -> bytes | None:
        """Return the bytes that have arrived; None if no bytes have arrived, b"" if the process has ended."""
        try:
            return self._socket.recv(1 << 16)
        except BlockingIOError:
            return None
        except OSError:
            return b""

    def locate(self) -> None:
        """Make the process report the script line that it executes."""
        if self._traces is not None and self._exit_code() is None:
            os.kill(self._process.pid, signal.SIGUSR1)

    def end(self) -> tuple[Message, ...]:
        """Kill the process. Return up to two messages for the user. If the process had already ended, the
        first message says why. If the script line that was executed last is known, another message names this
        line.
        """
        code = self._exit_code()
        self._kill()
        found = None if code is None else _exit_message(code), self._script_location()
        return tuple(each for each in found if each is not None)

    def finish(self, frame: bytes, is_done: Callable[[bytes], bool]) -> bool:
        """Send `frame`, a packed `FinishScripts` order. Pass received bytes to `is_done` until `is_done`
        returns True. Return False if the process ends before that, if a signal interrupts the shutdown, or
        after `FINISHES_WITHIN`.
        """
        self._unwatch()
        self.send(frame)
        until = self._clock() + FINISHES_WITHIN
        while self._clock() < until and not self._is_interrupted():
            writers = [self._socket] if self._backlog else []
            readable, writable, _ = select.select([self._socket], writers, [], _POLL_INTERVAL)
            if writable:
                self._flush()
            if readable and (data := self.receive()) is not None:
                if not data:
                    return False
                if is_done(data):
                    return True
        return False

    def close(self) -> None:
        """End the process of the scripts if it still runs, and release its file descriptors."""
        self._kill()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_EXITS_WITHIN)
        self._close_traces()

    def _close_traces(self) -> None:
        if self._traces is not None:
            os.close(self._traces)
            self._traces = None

    def _on_ready(self, events: int) -> None:
        self._flush()
        data = self.receive()
        if data == b"":
            self._unwatch()
        if data is not None:
            self._rules.on_script_data(data, time.monotonic_ns())

    def _flush(self) -> None:
        """Write as many pending bytes as fit into the socket's buffer."""
        try:
            while self._backlog:
                del self._backlog[: self._socket.send(self._backlog)]
        except BlockingIOError:
            pass
        except OSError:  # the process has ended, and the next `receive` will report the end
            self._backlog.clear()
        if self._watcher is not None and self._waits_to_write is not bool(self._backlog):
            self._waits_to_write = bool(self._backlog)
            self._watcher.change(self._socket.fileno(), READ | WRITE if self._waits_to_write else READ)

    def _unwatch(self) -> None:
        if self._watcher is not None:
            self._watcher.unwatch(self._socket.fileno())
            self._watcher = None

    def _kill(self) -> None:
        """End the process and all processes that it started in its session."""
        self._unwatch()
        self._socket.close()
        # after the end of the process, its id may belong to another process
        if self._process.returncode is None:
            if hasattr(os, "killpg"):
                # killpg fails if the process has just started, or is in another group
                with suppress(OSError):
                    os.killpg(self._process.pid, signal.SIGKILL)
            self._process.kill()

    def _exit_code(self) -> int | None:
        if not hasattr(os, "waitid") or self._process.returncode is not None:
            return self._process.poll()
        # With WNOWAIT, the process is not reaped, so the system does not reuse its process id.
        ended = os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        if ended is None:
            return None
        return ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status

    def _script_location(self) -> Message | None:
        """Return the script line that the process reported last, or at which it crashed."""
        if self._traces is None:
            return None
        try:
            trace = os.read(self._traces, _LONGEST_TRACE).decode("utf-8", "replace")
        except OSError:
            return None
        for path, line, function in _PLACE.findall(trace):
            if Path(path).name in self._files:
                return Message("script.place", file=Path(path).name, line=line, function=function)
        return None


def _exit_message(code: int) -> Message:
    if code >= 0:
        return Message("script.exit-code", code=code)
    try:
        return foreign_text(signal.Signals(-code).name)
    except ValueError:
        return foreign_text(f"signal {-code}")
