"""One stay in slave mode, as facts: plain fields for people, programs and rules to read.

Moments are nanoseconds since 1970-01-01 UTC, durations milliseconds; frames are numbers of observations.
Lists that a bad capture could make long hold the first few and stand beside a count of all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from bcapscope.analysis.distribution import Distribution
from bcapscope.protocol.slavemode import Generation, PoseType, SlaveMode
from bcapscope.traffic.observation import Conversation, Endpoint

MOST_LISTED = 64
"""Entries of each list of moments, the first ones; the worst ones where it says so."""


class Spot(NamedTuple):
    """A frame and when it was seen."""

    frame: int
    time: int


class Call(NamedTuple):
    """A call that bears on a stay.

    Attributes:
        call: its number.
        client: who asked.
        function_id: of its function.
        command: of an ..._Execute function.
        request: frame of its first request.
        time: of that.
        reply: frame of the accepted reply; None where there is none.
        replied: time of that; None likewise.
        hresult: in that reply; None likewise.
    """

    call: int
    client: Endpoint
    function_id: int
    command: str | None
    request: int
    time: int
    reply: int | None
    replied: int | None
    hresult: int | None


class SetPointFact(NamedTuple):
    """A set point that stands out.

    Attributes:
        call: number of its call.
        request: frame of its first request.
        time: of that.
        reply: frame of the accepted reply; None where there is none.
        hresult: in that reply; None likewise.
        latency_ms: from the first request to the reply; None likewise.
        cycle_ms: since the first request of the set point before; None for the first.
    """

    call: int
    request: int
    time: int
    reply: int | None
    hresult: int | None
    latency_ms: float | None
    cycle_ms: float | None


class Mode(NamedTuple):
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


class Format(NamedTuple):
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


class Exit(NamedTuple):
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
    by: Call | None


@dataclass(frozen=True, slots=True)
class Counts:
    """Set points of a stay, each once however often it was sent.

    Attributes:
        sent: all.
        accepted: answered with success.
        refused: answered with a failure, by HRESULT.
        unanswered: given up by the client without a reply, as far as was seen.
        open: still waiting for a reply when the capture ended.
        buffer_full: answered with S_BUF_FULL; accepted as well.
        after_end: refused after the end, as a consequence; in none of the other numbers.
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
    buffer_full: int
    after_end: int
    retries: int
    by_retries: Mapping[int, int]
    retries_forbidden: int
    late_replies: int
    lost_replies: int


class Deadline(NamedTuple):
    """A recommended time-out, and how many set points would have missed it.

    Attributes:
        name: for people.
        timeout_ms: of one try.
        tries: at the most, the first one with them.
        late: set points whose reply came later than one time-out after their first request, or never.
        given_up: set points whose reply came later than all tries together take, or never.
        applies: the one that is recommended for this mode and transport.
        source: who recommends it.
    """

    name: str
    timeout_ms: float
    tries: int
    late: int
    given_up: int
    applies: bool
    source: str


@dataclass(frozen=True, slots=True)
class Timing:
    """When set points were sent and answered.

    Attributes:
        cycle: between successive set points' first requests; None for fewer than two.
        grid_ms: the period that the client should keep, 8 or 1.
        grid_known_by: why this one, one clause.
        jitter: how far each cycle is from the grid, up or down; None likewise.
        on_grid: cycles no more than a tenth of the grid away from it.
        skipped: cycles of one and a half periods or more.
        backwards: set points that were seen earlier than the one before; left out of `cycle`.
        rate_hz: set points a second over the whole stay; None for fewer than two.
        latency: from the first request to the accepted reply; None without one.
        rtt: from the request that was answered to the accepted reply; None likewise.
        deadlines: recommended time-outs against `latency`.
        slowest: the set points with the longest latency or with no reply in time, worst first.
        slack_ms: what the controller's buffer can bridge when full, see `analysis.buffer.slack_ms`.
        gaps: cycles longer than `slack_ms`, all of them.
        gap_list: the first of them, each the set point behind the gap.
    """

    cycle: Distribution | None
    grid_ms: float
    grid_known_by: str
    jitter: Distribution | None
    on_grid: int
    skipped: int
    backwards: int
    rate_hz: float | None
    latency: Distribution | None
    rtt: Distribution | None
    deadlines: tuple[Deadline, ...]
    slowest: tuple[SetPointFact, ...]
    slack_ms: float
    gaps: int
    gap_list: tuple[SetPointFact, ...]


class Starved(NamedTuple):
    """A moment at which the model's buffer was empty when the controller wanted a set point.

    Attributes:
        time: when the point was wanted.
        after: frame of the last set point before.
        before: frame of the set point that came too late.
        missing: ticks of the controller that found nothing.
        late_ms: how long after `time` the point came.
        moving: whether the last two set points before differ; None where they could not be read.
    """

    time: int
    after: int
    before: int
    missing: int
    late_ms: float
    moving: bool | None


@dataclass(frozen=True, slots=True)
class Buffer:
    """The controller's buffer: what a model predicts and what the controller reported.

    Attributes:
        slots: set points that the buffer holds.
        period_ms: the model's period of the controller.
        overwrites: the newest point replaces the waiting one, so that running empty is no error.
        paces: replies wait for room.
        assumptions: what the model takes for granted, a clause each.
        starved: predicted, more than the unknown phase of the controller's clock can explain.
        starved_moving: those of them in motion, where they matter.
        starved_list: the first of them.
        maybe_starved: by one tick only: the phase decides.
        overflows: predicted: set points that came when the buffer was full, beyond the doubt of the phase.
        overflow_list: the first of them, by frame of the request.
        overwritten: where `overwrites`, points replaced before they were taken; else 0.
        smallest_level: points in the buffer when the next one came, at worst; None for fewer than two.
        smallest_slack_ms: time that was left until the buffer would have been empty, at worst; negative
            where it was.
        smallest_slack_at: frame of the set point that came then; None likewise.
        levels: how many set points found how many in the buffer.
        reported_underflows: frames of replies that said so (84201482).
        reported_overflows: frames of replies that said so (83201483).
        reported_full: frames of the first replies that said S_BUF_FULL.
    """

    slots: int
    period_ms: float
    overwrites: bool
    paces: bool
    assumptions: tuple[str, ...]
    starved: int
    starved_moving: int
    starved_list: tuple[Starved, ...]
    maybe_starved: int
    overflows: int
    overflow_list: tuple[int, ...]
    overwritten: int
    smallest_level: int | None
    smallest_slack_ms: float | None
    smallest_slack_at: int | None
    levels: Mapping[int, int]
    reported_underflows: tuple[int, ...]
    reported_overflows: tuple[int, ...]
    reported_full: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class ClockFacts:
    """The controller's time stamps (receive format 0x010) beside the capture's clock.

    Attributes:
        stamps: how many there were.
        microseconds: their unit is µs, not ms.
        unit_known_by: "slvRecvFormat", or "the pace of the stamps" where that was not seen.
        drift_ppm: how much faster the controller's clock runs; None for less than a second of stamps.
        jitter: by how much the delay changed from one reply to the next; None for fewer than two.
        step: from one stamp to the next; None likewise.
        missing: periods of the controller without a stamp between the first and the last.
        repeated: stamps equal to the one before.
        backwards: stamps before the one before, but for wraps.
        wraps: how often the 32-bit number wrapped.
    """

    stamps: int
    microseconds: bool
    unit_known_by: str
    drift_ppm: float | None
    jitter: Distribution | None
    step: Distribution | None
    missing: int
    repeated: int
    backwards: int
    wraps: int


class Peak(NamedTuple):
    """The largest value and the frame of the request it belongs to."""

    value: float
    frame: int


@dataclass(frozen=True, slots=True)
class AxisMotion:
    """One axis over a stay, as commanded; velocity and acceleration reckon with one set point each `grid_ms`.

    Attributes:
        name: J1, X, Rx and so on.
        unit: deg, mm, or empty.
        least: smallest commanded position.
        most: largest.
        step: size of each step between set points that follow each other; None for fewer than two.
        velocity: the same in units a second.
        acceleration: change of velocity, in units a second squared; None for fewer than three.
        largest_step: with its frame.
        largest_velocity: with its frame.
        largest_acceleration: with its frame.
        difference: commanded less returned in the same call, without sign; None where no such pose came
            back.
        largest_difference: with its frame.
        lag_cycles: set points by which the returned pose is behind, where they agree best; an estimate, None
            where the axis does not move enough for one.
    """

    name: str
    unit: str
    least: float
    most: float
    step: Distribution | None
    velocity: Distribution | None
    acceleration: Distribution | None
    largest_step: Peak | None
    largest_velocity: Peak | None
    largest_acceleration: Peak | None
    difference: Distribution | None
    largest_difference: Peak | None
    lag_cycles: float | None


class Jump(NamedTuple):
    """A step that is far larger than those on both sides of it.

    Attributes:
        frame: of the request that commands it.
        time: of that.
        axis: the axis of the largest one.
        step: on that axis, with sign.
    """

    frame: int
    time: int
    axis: str
    step: float


@dataclass(frozen=True, slots=True)
class Motion:
    """What the set points command and what came back.

    Set points refused since the buffer was full are left out: the same point is sent again.

    Attributes:
        read: set points whose pose could be read.
        unread: set points whose pose could not, or is of another type.
        not_finite: set points with a NaN or an infinity; in neither of the others' figures.
        not_finite_frames: the first of them.
        guessed: the pose type was worked out from the count of numbers.
        axes: axis by axis; () where no pose could be read.
        returned: replies with a pose of the same type.
        repeated: set points equal to the one before.
        stutters: of them, those between two that move: the robot is told to stop for one period.
        stutter_list: the first of them, by frame of the request.
        jumps: steps far larger than those on both sides.
        jump_list: the first of them.
        figure_changes: how often Fig changed; 0 for joints.
        lag_cycles: of all axes, an estimate; None where none has one.
        first_distance: first set point less the position known then, by axis; () where none is known.
        first_distance_known_by: what told that position, one clause; "" where nothing did.
        first_distance_frames: that prove both; () likewise.
    """

    read: int
    unread: int
    not_finite: int
    not_finite_frames: tuple[int, ...]
    guessed: bool
    axes: tuple[AxisMotion, ...]
    returned: int
    repeated: int
    stutters: int
    stutter_list: tuple[int, ...]
    jumps: int
    jump_list: tuple[Jump, ...]
    figure_changes: int
    lag_cycles: float | None
    first_distance: tuple[float, ...]
    first_distance_known_by: str
    first_distance_frames: tuple[int, ...]


class Slice(NamedTuple):
    """Figures of one slice of time.

    Attributes:
        begin: when it begins.
        sent: set points in it.
        retries: of them.
        refused: of them.
        unanswered: of them, those open when the capture ended left out.
        cycle: None where there was none.
        latency: None likewise.
        smallest_slack_ms: as in `Buffer`; None likewise.
    """

    begin: int
    sent: int
    retries: int
    refused: int
    unanswered: int
    cycle: Distribution | None
    latency: Distribution | None
    smallest_slack_ms: float | None


class Sample(NamedTuple):
    """A run of successive set points, for plots: enough of them for a picture, however long the stay.

    Attributes:
        time: of the first.
        frame: of its request.
        points: how many.
        cycle_least: shortest cycle in the run, ms; NaN where there is none.
        cycle_most: longest.
        latency_most: longest latency, ms; NaN where nothing was answered.
        slack_least: as `Buffer.smallest_slack_ms`; NaN for the very first set point.
        commanded: pose of the first; NaN where it could not be read.
        returned: pose in the reply to it; NaN likewise.
    """

    time: int
    frame: int
    points: int
    cycle_least: float
    cycle_most: float
    latency_most: float
    slack_least: float
    commanded: tuple[float, ...]
    returned: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Stay:
    """A stay in slave mode.

    Attributes:
        number: 1 for the one that began first.
        conversation: whose set points these are.
        robot: handle of the robot; None where it could not be read.
        entry: the slvChangeMode that began it; None where it began before the capture.
        entered: when it began, by the reply; else by the first set point.
        mode: what was asked for.
        send_format: None where none was seen: not the same as 0.
        receive_format: likewise.
        first: first set point; None for a stay without.
        last: last set point that belongs to it; None likewise.
        exit: how it ended.
        counts: set points.
        timing: when they came.
        buffer: what became of them in the controller, by a model.
        clock: None where no time stamps came back.
        motion: where they led; None for a stay without set points.
        refused_list: set points that were refused, the first ones.
        forbidden_retry_list: frames of the first retries that the mode forbids.
        other_calls: calls of any client to this controller that are no set points, from shortly before the
            beginning to shortly after the end, the last ones, in order of time.
        slices: figures by time, where asked for.
        slices_left_off: slices beyond those in `slices`.
        samples: for plots.
    """

    number: int
    conversation: Conversation
    robot: int | None
    entry: Call | None
    entered: int
    mode: Mode
    send_format: Format | None
    receive_format: Format | None
    first: Spot | None
    last: Spot | None
    exit: Exit
    counts: Counts
    timing: Timing
    buffer: Buffer
    clock: ClockFacts | None
    motion: Motion | None
    refused_list: tuple[SetPointFact, ...]
    forbidden_retry_list: tuple[int, ...]
    other_calls: tuple[Call, ...]
    slices: tuple[Slice, ...]
    slices_left_off: int
    samples: tuple[Sample, ...]

    @property
    def began_before_capture(self) -> bool:
        """Whether the slvChangeMode that began it was not seen."""
        return self.entry is None

    @property
    def duration_ms(self) -> float:
        """From the beginning to the end."""
        return (self.exit.time - self.entered) / 1e6
