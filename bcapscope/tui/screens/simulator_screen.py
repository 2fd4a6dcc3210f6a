"""The screen with the traffic of a simulator that bcapscope started."""

from __future__ import annotations

from textual.message import Message

from bcapscope.live.child_process import ChildProcess
from bcapscope.render.escape import printable
from bcapscope.tui.app import app_of
from bcapscope.tui.reader_language import label
from bcapscope.tui.screens.traffic_screen import TrafficScreen
from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed


class SimulatorEnded(Message):
    """The simulator ended unexpectedly; `text` is the simulator's last output."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text = text


class SimulatorScreen(TrafficScreen):
    """Shows the simulator's traffic and address."""

    def __init__(self, feed: TrafficFeed, address: str, child: ChildProcess) -> None:
        """Show the traffic of a feed and the simulator's address, and watch the simulator's process."""
        super().__init__(feed, address)
        self._address = address
        self._child = child

    def on_mount(self) -> None:
        """Show the address."""
        self._show_address("good", "●")
        app_of(self).show_message(label("simulator.listens", address=printable(self._address)))
        self._child.subscribe_end(self._post_end)

    def _post_end(self, text: str) -> None:
        """Forward the end of the simulator's process from a reader thread to the screen."""
        self.post_message(SimulatorEnded(text))

    def _show_address(self, ink: str, sign: str) -> None:
        app_of(self).status = ((f"{sign} {printable(self._address)} ", ink),)

    def on_simulator_ended(self, message: SimulatorEnded) -> None:
        """Report that the simulator has ended; its traffic stays on the screen."""
        message.stop()
        reason = label("simulator.ended", reason=printable(message.text) or label("proxy.killed"))
        self.feed.stop_reading()
        self.feed.report_source_problem(reason)
        self._show_address("bad", "○")
        app_of(self).show_message(reason, "error")
