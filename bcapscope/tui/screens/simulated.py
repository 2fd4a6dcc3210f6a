"""The traffic of a simulator that the screen has started."""

from __future__ import annotations

from textual.message import Message

from bcapscope.render.escape import printable
from bcapscope.tui.app import scope_of
from bcapscope.tui.child import Child
from bcapscope.tui.screens.traffic import TrafficScreen
from bcapscope.tui.traffic.feed import Feed
from bcapscope.tui.words import say, told


class Ended(Message):
    """The simulator has ended by itself; `text` are its last words."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text = text


class Simulated(TrafficScreen):
    """Shows traffic, and where the simulator listens."""

    def __init__(self, feed: Feed, address: str, child: Child) -> None:
        """Take what is read, where the simulator listens, and its process."""
        super().__init__(feed, address)
        self._address = address
        self._child = child

    def on_mount(self) -> None:
        """Tell where it listens."""
        self._tell_place("good", "●")
        scope_of(self).tell(say("simulator.listens", address=printable(self._address)))
        self._child.at_end(self._ended)

    def _ended(self, text: str) -> None:
        """Hear of the end in another thread."""
        self.post_message(Ended(text))

    def _tell_place(self, ink: str, sign: str) -> None:
        scope_of(self).status = ((f"{sign} {printable(self._address)} ", ink),)

    def on_ended(self, message: Ended) -> None:
        """Tell that it is gone; what was seen stays."""
        message.stop()
        reason = say("simulator.ended", reason=printable(told(message.text)) or say("proxy.no_words"))
        self.feed.stop()
        self.feed.doubt(reason)
        self._tell_place("bad", "○")
        scope_of(self).tell(reason, "error")
