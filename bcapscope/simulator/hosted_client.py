"""A client of a simulated or recorded controller: one call runs at a time, and further requests wait."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque

from bcapscope.protocol.codec.frame import LARGEST_FRAME, LARGEST_UDP_FRAME, Frame
from bcapscope.protocol.retry.reserved_convention import ReplyReserved
from bcapscope.protocol.retry.responder import REMEMBERED_ANSWERS, Defect, RequestKind, Responder
from bcapscope.protocol.tables.hresult import E_BUSY

MAX_WAITING = 16
"""Maximum number of a client's requests that wait while a call runs. Only bcapscope has this limit."""

_NEW = RequestKind.NEW


class HostedClient(ABC):
    """Starts the calls of one client, one after another. A subclass decides when a call ends."""

    def __init__(
        self,
        udp: bool,
        reply_reserved: ReplyReserved,
        remembered: int = REMEMBERED_ANSWERS,
        defects: Defect = Defect.NONE,
    ) -> None:
        self.last_heard = 0
        self._responder = Responder(
            expects_retries=udp,
            reply_reserved=reply_reserved,
            remembered=remembered,
            largest_answer=LARGEST_UDP_FRAME if udp else LARGEST_FRAME,
            defects=defects,
        )
        self._waiting: deque[Frame] = deque()
        self._is_timed_out = False

    @property
    @abstractmethod
    def running(self) -> object:
        """Truthy while a call runs, so that the host must call `poll`; falsy otherwise."""

    @property
    def _is_unanswered(self) -> bool:
        """Whether the current call never gets a reply. The client's next request ends an unanswered call."""
        return False

    @abstractmethod
    def poll(self, now: int) -> list[bytes]:
        """Return the frames to send now: the reply to a finished call, or a notice that is due."""

    @abstractmethod
    def due(self, now: int) -> int | None:
        """Return the time of the next poll in ns; None if no call runs."""

    @abstractmethod
    def _start_call(self, frame: Frame, now: int) -> list[bytes]:
        """Start a new call, and return the frames to send now."""

    def on_request(self, frame: Frame, now: int) -> list[bytes]:
        decision = self._responder.receive_request(frame)
        if decision.kind is _NEW:
            frames = self._start_call(frame, now)
            return frames + self._start_waiting(now) if self._waiting else frames
        if decision.reply is not None:
            return [decision.reply]
        if decision.kind is RequestKind.RUNNING:
            return []
        if self._is_unanswered:
            self._responder.abandon_call()
            return self.on_request(frame, now)
        if self._is_timed_out or len(self._waiting) >= MAX_WAITING:
            return [self._responder.reply_unremembered(frame, E_BUSY)]
        self._waiting.append(frame)
        return []

    def close(self) -> None:
        self._waiting.clear()
        self._responder.reset()

    def _start_waiting(self, now: int) -> list[bytes]:
        frames: list[bytes] = []
        while self._waiting and (self._is_unanswered or not self._responder.is_call_running):
            frames += self.on_request(self._waiting.popleft(), now)
        return frames
