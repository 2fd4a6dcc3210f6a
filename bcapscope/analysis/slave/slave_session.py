"""Facts about one slave-mode session: plain fields for people, programs and rules.

Times are ns since 1970-01-01 UTC, durations are ms, and frames are observation numbers. A list that
could grow long in a bad capture holds only its first few entries. A separate field holds the total count.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from bcapscope.analysis.slave.buffer_model import BufferFacts
from bcapscope.analysis.slave.controller_clock import ClockFacts
from bcapscope.analysis.slave.motion_model import MotionFacts
from bcapscope.analysis.slave.notable_set_points import SetPointFact
from bcapscope.analysis.slave.plot_samples import PlotSample
from bcapscope.analysis.slave.session_slices import SessionSlice
from bcapscope.analysis.slave.timing_model import TimingFacts
from bcapscope.messages import Message
from bcapscope.protocol.slave_mode.modes import Generation, PoseType, SlaveMode
from bcapscope.traffic.observation import Conversation, Endpoint


class FrameTime(NamedTuple):
    """A frame and the time when it was captured."""

    frame: int
    time: int


class CallFact(NamedTuple):
    """A call that is relevant to a slave-mode session; `time` is that of the first request."""

    call: int
    client: Endpoint
    function_id: int
    command: str | None
    request_frame: int
    time: int
    reply_frame: int | None
    reply_time: int | None
    hresult: int | None


class KnownMode(NamedTuple):
    """The slave mode, and how it is known.

    Attributes:
        value: Argument of slvChangeMode; None if unknown.
        known_by: Source of the value: "slvChangeMode", "slvGetMode", or "" if unknown.
        meaning: Mode that the value stands for on this generation, or on an RC8 if the generation is unknown;
            None for an undefined or unknown value.
        guessed: `meaning` is that of an RC8 because the generation is unknown.
        pose_type: Pose type of the set points, from the mode or else from the count of their numbers.
    """

    value: int | None
    known_by: str
    generation: Generation | None
    generation_known_by: Message | None
    meaning: SlaveMode | None
    guessed: bool
    pose_type: PoseType | None


class AcceptedFormat(NamedTuple):
    """A send or receive format that the controller accepted before or during the slave-mode session.

    Attributes:
        value: Bits of the format.
        microseconds: True if the unit of the time stamp is µs, not ms.
    """

    value: int
    microseconds: bool
    frame: int


class ExitReason(StrEnum):
    """How a slave-mode session ended."""

    LEFT = "left"
    """The client that sends the set points called slvChangeMode 0."""
    CHANGED = "changed"
    """slvChangeMode entered another mode, or the same mode again."""
    ERROR = "error"
    """A set point was refused with an error that ends slave mode."""
    OTHER_CALL = "other call"
    """Slave mode was found off after an error in another call, of any client, had ended it."""
    OTHER_CLIENT = "other client"
    """Another client of the controller called slvChangeMode."""
    FOUND_OFF = "found off"
    """A set point was refused because slave mode is off; no captured frame shows what ended it."""
    DISCONNECTED = "disconnected"
    """Robot_Release, Controller_Disconnect, Service_Stop, or a new Service_Start."""
    SILENT = "silent"
    """The client sent no more set points although the capture goes on: the client or the connection died."""
    CAPTURE_ENDED = "capture ended"


class SessionExit(NamedTuple):
    """The end of a slave-mode session.

    Attributes:
        time: Time of the end: that of the reply that shows it, if there is one.
        frames: Request and reply frames that prove it; () if none was captured.
        hresult: Code of the error that ended it, or of the reply to the call that ended it; None without one.
        by: Call that ended it, or that found slave mode off for `FOUND_OFF`; None without one.
    """

    reason: ExitReason
    time: int
    frames: tuple[int, ...]
    hresult: int | None
    by: CallFact | None


@dataclass(frozen=True, slots=True)
class SetPointCounts:
    """Number of set points in a slave-mode session; each counts once, however often it was sent.

    Attributes:
        refused: Set points answered with a failure, by HRESULT.
        unanswered: Set points that the client gave up; no reply was captured.
        open: Set points that waited for a reply when the capture ended.
        not_followed: Set points evicted from memory before a reply arrived.
        buffer_full: Set points answered with S_BUF_FULL; `accepted` includes them.
        after_end: Set points refused or unanswered after the end, as a consequence; no other field includes
            them.
        by_retries: Number of set points by number of retries, including 0.
        retries_forbidden: Retries over UDP in a mode in which the newest point wins; they waste bandwidth
            (DENSO Wave 2009, How to use the Slave mode).
        late_replies: Replies that came after the client had sent another attempt.
        lost_replies: Replies that were captured, although the client retried afterwards.
    """

    sent: int
    accepted: int
    refused: Mapping[int, int]
    unanswered: int
    open: int
    not_followed: int
    buffer_full: int
    after_end: int
    retries: int
    by_retries: Mapping[int, int]
    retries_forbidden: int
    late_replies: int
    lost_replies: int


@dataclass(frozen=True, slots=True)
class SlaveSession:
    """A slave-mode session.

    Attributes:
        number: Number in the order of start times, counted from 1.
        entry_call: The slvChangeMode that began it; None if it began before the capture.
        entered_at: Start: time of the reply to `entry_call`, else of the first set point.
        send_format: Accepted send format; None if none was seen, which is not the same as 0.
        receive_format: Accepted receive format; None if none was seen.
        clock: Time stamps of the controller; None if none came back.
        motion: Commanded motion; None without set points.
        forbidden_retry_frames: Frames of the first retries that the mode forbids.
        other_calls: Other calls of any client to this controller, except set points, from shortly before the
            start to shortly after the end. Holds the last ones, in order of time.
        slices: Figures per slice of time, if requested.
    """

    number: int
    conversation: Conversation
    robot: int | None
    entry_call: CallFact | None
    entered_at: int
    mode: KnownMode
    send_format: AcceptedFormat | None
    receive_format: AcceptedFormat | None
    first_set_point: FrameTime | None
    last_set_point: FrameTime | None
    exit: SessionExit
    counts: SetPointCounts
    timing: TimingFacts
    buffer: BufferFacts
    clock: ClockFacts | None
    motion: MotionFacts | None
    refused_set_points: tuple[SetPointFact, ...]
    forbidden_retry_frames: tuple[int, ...]
    other_calls: tuple[CallFact, ...]
    slices: tuple[SessionSlice, ...]
    slices_left_off: int
    samples: tuple[PlotSample, ...]

    @property
    def began_before_capture(self) -> bool:
        return self.entry_call is None

    @property
    def duration_ms(self) -> float:
        """Time from start to end, ms."""
        return (self.exit.time - self.entered_at) / 1e6
