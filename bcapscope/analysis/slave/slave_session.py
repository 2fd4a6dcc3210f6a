"""Facts about one slave-mode session.

Times are in ns since 1970-01-01 UTC. Durations are in ms. Frames are given by their observation numbers. Long
lists are cut off; in most cases, a separate field has the total number of entries.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from bcapscope.analysis.slave.buffer_model import BufferFacts
from bcapscope.analysis.slave.controller_clock import ClockFacts
from bcapscope.analysis.slave.motion_model import MotionFacts
from bcapscope.analysis.slave.motion_pace import MotionPace
from bcapscope.analysis.slave.notable_set_points import SetPointFact
from bcapscope.analysis.slave.plot_samples import PlotSample
from bcapscope.analysis.slave.session_slices import SessionSlice
from bcapscope.analysis.slave.timing_model import TimingFacts
from bcapscope.messages import Message
from bcapscope.protocol.slave_mode.modes import Generation, PoseType, SlaveMode
from bcapscope.traffic.observation import Conversation, Endpoint


class FrameTime(NamedTuple):
    """The number of a frame, and its capture time in ns since 1970."""

    frame: int
    time: int


class CallFact(NamedTuple):
    """A call that is relevant to a slave-mode session.

    Attributes:
        call: Number of the call.
        time: Capture time of the first request, ns since 1970.
        reply_time: Capture time of the accepted reply, ns since 1970; None if there is no such reply.
        hresult: Result code of the accepted reply, unsigned; None if there is no such reply.
    """

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
    """The slave mode of a session, and how the mode is known.

    Attributes:
        value: Number of the mode, as in the argument of slvChangeMode; None if unknown.
        known_by: Command that shows the value: "slvChangeMode" or "slvGetMode"; "" if the value is unknown.
        meaning: Slave mode that `value` selects on this generation of controllers; None if `value` is
            undefined or unknown.
        guessed: Whether `meaning` assumes an RC8, because the generation is unknown.
        pose_type: Pose type of the set points. If the mode is unknown, the number of values in a pose shows
            the pose type.
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
        value: Bits of the format, as the client sent them.
        microseconds: True if the controller's time stamps are in µs, False if they are in ms.
    """

    value: int
    microseconds: bool
    frame: int


class ExitReason(StrEnum):
    """How a slave-mode session ended."""

    LEFT = "left"
    """The client left slave mode with slvChangeMode 0."""
    CHANGED = "changed"
    """The client entered another slave mode, or the same slave mode again, with slvChangeMode."""
    ERROR = "error"
    """The controller refused a set point with an error that ends slave mode."""
    OTHER_CALL = "other call"
    """A call other than a set point failed with an error that ends slave mode. Later, the controller refused
    a set point because slave mode was off.
    """
    OTHER_CLIENT = "other client"
    """Another client of the controller called slvChangeMode."""
    FOUND_OFF = "found off"
    """The controller refused a set point because slave mode was off. No captured frame shows what had ended
    slave mode.
    """
    DISCONNECTED = "disconnected"
    """The client called Robot_Release, Controller_Disconnect, Service_Stop or Service_Start."""
    SILENT = "silent"
    """The client stopped sending set points before the capture ended, because the client or the connection
    failed.
    """
    CAPTURE_ENDED = "capture ended"


class SessionExit(NamedTuple):
    """The end of a slave-mode session.

    Attributes:
        time: Time when the session ended, or time of the reply that shows the end, ns since 1970.
        frames: Numbers of the request and reply frames that prove the end; () if no such frame was captured.
        hresult: Result code of the call in the attribute `by`; None without a call or a reply.
        by: Call that ended the session; None if no call shows the end. For `FOUND_OFF`, `by` is the set point
            that was refused because slave mode was off.
    """

    reason: ExitReason
    time: int
    frames: tuple[int, ...]
    hresult: int | None
    by: CallFact | None


@dataclass(frozen=True, slots=True)
class SetPointCounts:
    """Counts of the set points in a slave-mode session. A set point with retries counts once.

    Attributes:
        refused: For each HRESULT of a failure, the number of set points that the controller answered with it.
        unanswered: Number of set points that the client gave up and for which no reply was captured.
        open: Number of set points that waited for a reply when the capture ended.
        not_followed: Number of set points that bcapscope evicted from memory before a reply arrived.
        not_captured: Number of set points whose reply the capture lacks (see `Outcome.NOT_CAPTURED`).
        buffer_full: Number of set points that were answered with S_BUF_FULL; `accepted` includes them.
        after_end: Number of set points that were refused or unanswered because the session had ended; no
            other field includes them.
        by_retries: Number of set points for each number of retries, including 0.
        retries_forbidden: Number of retries over UDP in a mode where each new set point replaces the one in
            the buffer, so that retries waste bandwidth (DENSO Wave 2009, How to use the Slave mode).
        late_replies: Number of replies that arrived after the client had sent another attempt.
        lost_replies: Number of replies that were captured, and that the client evidently did not receive.
    """

    sent: int
    accepted: int
    refused: Mapping[int, int]
    unanswered: int
    open: int
    not_followed: int
    not_captured: int
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
        number: Number of the slave-mode session in the order of start times, counted from 1.
        robot: Handle of the robot; None if the handle is not readable.
        mode: Slave mode, and how it is known.
        buffer: Estimated level of the controller's buffer.
        refused_set_points: First set points that the controller refused.
        slices_left_off: Number of slices that are missing from `slices`, because there were too many.
        samples: Set points for charts; each can stand for several neighbouring set points.
        entry_call: The slvChangeMode call that began the session; None if it was not captured.
        entered_at: Time of the reply to `entry_call`, or else of its request. Without `entry_call`, time of
            the first set point.
        send_format: Send format that the controller accepted; None if no slvSendFormat was captured.
        receive_format: Receive format that the controller accepted; None if no slvRecvFormat was captured.
        pace: Pace of the set points while the robot moves; None if the capture shows no motion.
        clock: Facts about the controller's time stamps; None if no reply has a time stamp.
        motion: Facts about the commanded motion; None if there are no set points.
        forbidden_retry_frames: Numbers of the first retry frames that the mode forbids.
        other_calls: Latest calls, except set points, that any client made to this controller during the
            session and shortly before or after, in chronological order.
        slices: Figures of the session for each slice of time; () if no slices were requested.
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
    pace: MotionPace | None
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
        """Time from the start of the session to its end, ms."""
        return (self.exit.time - self.entered_at) / 1e6
