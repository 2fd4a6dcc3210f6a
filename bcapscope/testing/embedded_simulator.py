"""A simulated controller in a thread of the program that tests a client."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING

from bcapscope.errors import InputError
from bcapscope.faults.fault_notation import read_fault
from bcapscope.live.background_recorder import BackgroundRecorder
from bcapscope.live.recorder import Recorder
from bcapscope.messages.message import foreign_text
from bcapscope.simulator.controller_setup import played_scenario, start_controller
from bcapscope.simulator.scenario import Scenario, load_scenario
from bcapscope.testing.recording_context import LOOPBACK, RecordingContext

if TYPE_CHECKING:
    from bcapscope.simulator.simulator_server import SimulatorServer

_WRITTEN_WITHIN = 5.0  # seconds for the recorder to write the waiting packets


class EmbeddedSimulator(RecordingContext):
    """A simulated controller that answers b-CAP clients on a free loopback port, over UDP and TCP.

        with bcapscope.Simulator(profile="rc8", faults=["loss=5%"], seed=3) as simulator:
            run_my_client(simulator.host, simulator.port)
            assert not simulator.findings

    The controller runs in a thread of its own until the `with` or `async with` block ends. A client that
    blocks the event loop therefore does not delay the controller's replies.

    Attributes:
        host: Address on which the controller listens.
        port: Port for UDP and TCP; 0 before the `with` block begins.
        recording: Capture of the traffic, as seen at the controller. Without `record`, the file is temporary
            and exists until the block ends.
    """

    def __init__(
        self,
        *,
        profile: str | None = None,
        scenario: str | Path | None = None,
        faults: Sequence[str] = (),
        seed: int | None = None,
        record: str | Path | None = None,
    ) -> None:
        """Choose the controller, which starts when the `with` block begins.

        Args:
            profile: Kind of controller: `rc7`, `rc8`, `rc9` or `cserver`. Default: the profile of the
                scenario, or `rc8` without a scenario.
            scenario: Name of an included scenario, or path of a YAML file, as for `bcapscope sim --scenario`.
            faults: Faults in the notation of `bcapscope proxy --fault`, such as `loss=5%`.
            seed: Random seed of the faults. The same seed and traffic give the same faults.
            record: Path of the capture to write; the file must not exist.

        Raises:
            InputError: The profile, the scenario or a fault is invalid.
            OSError: The file of the scenario cannot be read.
        """
        chosen = None if scenario is None else _load(str(scenario))
        super().__init__(record)
        self._scenario = played_scenario(chosen, profile, faults=[read_fault(each) for each in faults])
        self._seed = seed
        self._thread: _ServerThread | None = None

    def _start(self, opened: ExitStack) -> tuple[int, ...]:
        """Raises SimulatorListenError if no port is free, or FileWriteError if the file cannot be created."""
        from bcapscope.simulator.simulator_server import SimulatorServer  # imports asyncio

        _, controller = start_controller(self._scenario, self._seed)
        server = opened.enter_context(closing(SimulatorServer(controller, LOOPBACK, 0)))
        recorder = BackgroundRecorder(Recorder(self.recording, lambda warning: None))
        opened.callback(recorder.close)
        server.tap = recorder
        self._thread = opened.enter_context(closing(_ServerThread(server, recorder)))
        return (server.address[1],)

    def _stop(self) -> None:
        if self._thread is not None:
            self._thread.close()
            self._thread.write_recording()

    def _write_recording(self) -> None:
        if self._thread is not None:
            self._thread.write_recording()


class _ServerThread:
    """The thread that serves the clients and records the traffic."""

    def __init__(self, server: SimulatorServer, recorder: BackgroundRecorder) -> None:
        self._server = server
        self._recorder = recorder
        self._is_encoded, self._is_closing = Event(), False
        self._own_end, self._other_end = socket.socketpair()
        self._error: BaseException | None = None
        self._thread = Thread(target=self._run, name="bcapscope simulator", daemon=True)
        self._thread.start()

    def write_recording(self) -> None:
        """Write all packets so far to the file. Raise the error that ended the thread, if there is one."""
        if self._thread.is_alive():
            self._is_encoded.clear()
            self._other_end.send(b"\0")
            while not self._is_encoded.wait(0.1) and self._thread.is_alive():
                pass
        self._recorder.wait_until_written(_WRITTEN_WITHIN)
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        if self._thread.is_alive():
            self._is_closing = True
            self._other_end.send(b"\0")
            self._thread.join()
        self._own_end.close()
        self._other_end.close()

    def _run(self) -> None:
        from bcapscope.simulator.simulator_server import serve

        try:
            serve(self._server, self._recorder.on_idle, self._on_wish, [self._own_end.fileno()])
        except _EndServing:
            return
        except Exception as error:  # `write_recording` raises the stored error in the thread of the test
            self._error = error

    def _on_wish(self, descriptor: int) -> None:
        self._own_end.recv(1)
        while self._recorder.on_idle():
            pass
        if self._is_closing:
            raise _EndServing
        self._is_encoded.set()


class _EndServing(Exception):
    """Ends the loop of the thread that serves the clients."""


def _load(name_or_path: str) -> Scenario:
    try:
        return load_scenario(name_or_path)
    except LookupError as error:
        raise InputError(foreign_text(error.args[0])) from None
