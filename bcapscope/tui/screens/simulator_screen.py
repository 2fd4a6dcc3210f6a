"""The traffic of a simulator that the screen has started."""

from __future__ import annotations

from textual.message import Message

from bcapscope.live.child_process import ChildProcess
from bcapscope.render.escape import printable
from bcapscope.tui.app import app_of
from bcapscope.tui.screens.traffic_screen import TrafficScreen
from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed
from bcapscope.tui.words import say, told


class SimulatorEnded(Message):
    """The simulator has ended by itself; `text` are its last words."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text = text


class SimulatorScreen(TrafficScreen):
    """Shows traffic, and where the simulator listens."""

    def __init__(self, feed: TrafficFeed, address: str, child: ChildProcess) -> None:
        """Take what is read, where the simulator listens, and its process."""
        super().__init__(feed, address)
        self._address = address
        self._child = child

    def on_mount(self) -> None:
        """Tell where it listens."""
        self._show_address("good", "●")
        app_of(self).show_message(say("simulator.listens", address=printable(self._address)))
        self._child.subscribe_end(self._post_end)

    def _post_end(self, text: str) -> None:
        """Hear of the end in another thread."""
        self.post_message(SimulatorEnded(text))

    def _show_address(self, ink: str, sign: str) -> None:
        app_of(self).status = ((f"{sign} {printable(self._address)} ", ink),)

    def on_simulator_ended(self, message: SimulatorEnded) -> None:
        """Tell that it is gone; what was seen stays."""
        message.stop()
        reason = say("simulator.ended", reason=printable(told(message.text)) or say("proxy.no_words"))
        self.feed.stop_reading()
        self.feed.report_source_problem(reason)
        self._show_address("bad", "○")
        app_of(self).show_message(reason, "error")
