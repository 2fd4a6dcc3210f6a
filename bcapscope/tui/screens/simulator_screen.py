"""The screen with the traffic of a simulator that bcapscope started."""

from __future__ import annotations

from functools import partial

from bcapscope.live.child_process import ChildProcess
from bcapscope.render.escape import printable
from bcapscope.tui.app import app_of
from bcapscope.tui.reader_language import label
from bcapscope.tui.screens.traffic_screen import TrafficScreen
from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed


class SimulatorScreen(TrafficScreen):
    """Shows the traffic and the address of a simulator, whose process is `child`."""

    def __init__(self, feed: TrafficFeed, address: str, child: ChildProcess) -> None:
        super().__init__(feed, address)
        self._address = address
        self._child = child

    def on_mount(self) -> None:
        self._show_address("good", "●")
        app_of(self).show_message(label("simulator.listens", address=printable(self._address)))
        self._child.subscribe_end(partial(self.call_in_screen, self._show_end))

    def _show_address(self, ink: str, sign: str) -> None:
        app_of(self).status = ((f"{sign} {printable(self._address)} ", ink),)

    def _show_end(self, last_line: str) -> None:
        """Report that the simulator has ended; its traffic remains on the screen."""
        reason = label("simulator.ended", reason=printable(last_line) or label("proxy.killed"))
        self.feed.stop_reading()
        self.feed.report_source_problem(reason)
        self._show_address("bad", "○")
        app_of(self).show_message(reason, "error")
