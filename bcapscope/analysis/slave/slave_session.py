"""One stay in slave mode, as facts: plain fields for people, programs and rules to read.

Moments are nanoseconds since 1970-01-01 UTC, durations milliseconds; frames are numbers of observations.
Lists that a bad capture could make long hold the first few and stand beside a count of all.
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
from bcapscope.protocol.slave_mode.modes import Generation, PoseType, SlaveMode
from bcapscope.traffic.observation import Conversation, Endpoint


class FrameTime(NamedTuple):
    """A frame and when it was seen."""

    frame: int
    time: int


class CallFact(NamedTuple):
    """A call that bears on a stay.

    Attributes:
        call: its number.
        client: who asked.
        function_id: of its function.
        command: of an ..._Execute function.
        request_frame: frame of its first request.
        time: of that.
        reply_frame: frame of the accepted reply; None where there is none.
        reply_time: time of that; None likewise.
        hresult: in that reply; None likewise.
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
    """The slave mode, and how it is known.

    Attributes:
        value: of slvChangeMode; None where that was not seen.
        known_by: what told the value: "slvChangeMode", "slvGetMode", or "" where nothing did.
        generation: of the controller; None where nothing told.
        generation_known_by: what told it, one clause; "" where nothing did.
        meaning: of the value on this generation, on an RC8 where that is not known; None for a value that has
            none and where there is no value.
        guessed: `meaning` is that of an RC8 though the generation is not known.
        pose_type: of the set points, by the mode, else by how many numbers they have.
    """

    value: int | None
    known_by: str
    generation: Generation | None
    generation_known_by: str
    meaning: SlaveMode | None
    guessed: bool
    pose_type: PoseType | None


class AcceptedFormat(NamedTuple):
    """A send or receive format that was accepted before or during the stay.

    Attributes:
        value: its bits.
        microseconds: unit of the time stamp.
        frame: of the request.
    """

    value: int
    microseconds: bool
    frame: int


class ExitReason(StrEnum):
    """How a stay ended."""

    LEFT = "left"
    """slvChangeMode 0 by the client of the set points."""
    CHANGED = "changed"
    """slvChangeMode to another mode, or again to the same."""
    ERROR = "error"
    """A set point was refused with an error that ends slave mode."""
    OTHER_CALL = "other call"
    """Found off, after another call of any client was refused with an error that ends slave mode."""
    OTHER_CLIENT = "other client"
    """slvChangeMode by another client of the controller."""
    FOUND_OFF = "found off"
    """A set point was refused since slave mode is off, and nothing that was seen had ended it."""
    DISCONNECTED = "disconnected"
    """Robot_Release, Controller_Disconnect, Service_Stop, or a new Service_Start."""
    SILENT = "silent"
    """No more set points, though the capture goes on: the client died, or the connection did."""
    CAPTURE_ENDED = "capture ended"


class SessionExit(NamedTuple):
    """The end of a stay.

    Attributes:
        reason: how it ended.
        time: when; of the reply that tells it, where there is one.
        frames: that prove it: request and reply; () where nothing was seen.
        hresult: of the error that ended it, or in the reply to what ended it; None without one.
        by: the call that ended it or, for `FOUND_OFF`, that told it; None where there is none.
    """

    reason: ExitReason
    time: int
    frames: tuple[int, ...]
    hresult: int | None
    by: CallFact | None


@dataclass(frozen=True, slots=True)
class SetPointCounts:
    """Set points of a stay, each once however often it was sent.

    Attributes:
        sent: all.
        accepted: answered with success.
        refused: answered with a failure, by HRESULT.
        unanswered: given up by the client without a reply, as far as was seen.
        open: still waiting for a reply when the capture ended.
        not_followed: still waiting for a reply when they were let go, since more was open than is kept.
        buffer_full: answered with S_BUF_FULL; accepted as well.
        after_end: refused or not answered after the end, as a consequence; in none of the other numbers.
        retries: requests beyond the first of each.
        by_retries: how many set points were sent again so often; 0 among the keys.
        retries_forbidden: retries in a mode in which the newest point wins, over UDP: wasted bandwidth (DENSO
            Wave 2009, How to use the Slave mode).
        late_replies: replies that came after the client had sent another try.
        lost_replies: replies that were seen, and yet the client asked again.
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
    """A stay in slave mode.

    Attributes:
        number: 1 for the one that began first.
        conversation: whose set points these are.
        robot: handle of the robot; None where it could not be read.
        entry_call: the slvChangeMode that began it; None where it began before the capture.
        entered_at: when it began, by the reply; else by the first set point.
        mode: what was asked for.
        send_format: None where none was seen: not the same as 0.
        receive_format: likewise.
        first_set_point: first set point; None for a stay without.
        last_set_point: last set point that belongs to it; None likewise.
        exit: how it ended.
        counts: set points.
        timing: when they came.
        buffer: what became of them in the controller, by a model.
        clock: None where no time stamps came back.
        motion: where they led; None for a stay without set points.
        refused_set_points: set points that were refused, the first ones.
        forbidden_retry_frames: frames of the first retries that the mode forbids.
        other_calls: calls of any client to this controller that are no set points, from shortly before the
            beginning to shortly after the end, the last ones, in order of time.
        slices: figures by time, where asked for.
        slices_left_off: slices beyond those in `slices`.
        samples: for plots.
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
        """Whether the slvChangeMode that began it was not seen."""
        return self.entry_call is None

    @property
    def duration_ms(self) -> float:
        """From the beginning to the end."""
        return (self.exit.time - self.entered_at) / 1e6
