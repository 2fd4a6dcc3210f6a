"""What the player's process is told and what it tells: JSON, one object a line.

First comes the `PlayPlan`, then orders; back come facts, progress, questions and in the end one `PlayEnded`.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import TypeAlias

import msgspec

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.player.lateness import Spread
from bcapscope.protocol.slave_mode.modes import PoseType

SetPointValues: TypeAlias = tuple[float, ...]
"""Numbers of one set point, in the order and units of its pose type (`protocol.poses.AXES`)."""


TYPE_NAME_FACT = "type name"
"""Which of a controller's facts is the name of the robot's type."""


class SlaveModePacing(StrEnum):
    """A kind of slave mode that controllers of all generations have under one number or another."""

    SYNC = "sync"
    """The controller sets the pace: Sync on RC7, mode 2 on later ones."""
    ASYNC = "async"
    """We do, and the newest set point wins: Async on RC7, mode 1 on later ones."""


class CleanupTask(StrEnum):
    """Something that the player begins and has to end, whatever happens."""

    ROBSLAVE = "RobSlave"
    ARM = "arm"
    MOTOR = "motor"
    MOTION = "motion"
    """To the first point, by an ordinary motion, which goes on by itself."""
    LOG = "log"
    SLAVE_MODE = "slave mode"


class Aftermath(msgspec.Struct, frozen=True):
    """What a player has left that did not live to end what it had begun.

    Attributes:
        debts: that it had, the oldest first.
        generation: of the controller.
        port: that it sent from. Over UDP its conversation is taken up again from there, since that is how a
            controller knows its client.
        serial: to go on with, beyond any that it can have used.
    """

    debts: tuple[CleanupTask, ...]
    generation: str
    port: int
    serial: int


class PlayPlan(msgspec.Struct, frozen=True, kw_only=True):
    """What to play and where.

    Attributes:
        target: the controller and how to reach it.
        robot: name for Controller_GetRobot.
        task: of the program that RC7 needs for slave mode.
        kind: pose type of the set points.
        mode: kind of slave mode, or the very number for slvChangeMode.
        period: ns from one set point to the next, where no reply of the controller decides that.
        points: set points; the robot rests at the first and the last. Axes that are left out stay where they
            are.
        limits: of the arm, as `arm_limits.with_limits` takes them; a stop keeps within them.
        rounds: how often to play them, the first following the last; 0 until it is told to stop.
        approach: percentage of the speed of an ordinary motion to the first point.
        may_approach: go there without asking.
        armed: the user knows that a robot will move.
        look_only: connect, tell what is there, and end; nothing moves and nothing is changed.
        log: path of a new CSV file for the controller's own log; None for no log.
        record: path of a new capture of all that was said; None for none.
        realtime: take real-time priority if the system gives it.
        aftermath: end only what this says, and play nothing; None to play.
    """

    target: ControllerTarget
    robot: str = "Arm"
    task: str = "RobSlave"
    kind: PoseType = PoseType.J
    mode: SlaveModePacing | int = SlaveModePacing.SYNC
    period: int = 8_000_000
    points: Sequence[SetPointValues] = ()
    limits: tuple[str, ...] = ()
    rounds: int = 1
    approach: float = 10.0
    may_approach: bool = False
    armed: bool = False
    look_only: bool = False
    log: str | None = None
    record: str | None = None
    realtime: bool = True
    aftermath: Aftermath | None = None


class Order(StrEnum):
    """What the player can be told while it is at work."""

    STOP = "stop"
    """Come to rest on the way, then leave in order."""
    HALT = "halt"
    """Stop the arm at once, then leave in order."""


class PlayerCommand(msgspec.Struct, frozen=True):
    """An order, or the answer to a question.

    Attributes:
        order: None for an answer.
        answer: to the question that was asked last.
    """

    order: Order | None = None
    answer: str = ""


class PlayState(StrEnum):
    """What the player is doing."""

    CONNECTING = "connecting"
    PREPARING = "preparing"
    APPROACHING = "moving to the first point"
    ENTERING = "entering slave mode"
    PLAYING = "playing"
    STOPPING = "coming to rest"
    LEAVING = "leaving"
    CLEARING = "clearing the error"


class ControllerInfo(msgspec.Struct, frozen=True, tag=True):
    """Who is there.

    Attributes:
        simulator: it is our own, and no robot moves.
        generation: RC7, or RC8 for all later ones.
        facts: what the controller says of itself.
        mode: that it will be played in.
        pose: where the robot is, in the pose type of the set points.
        distance: how far the first point is from there: the largest difference of an axis, deg or mm.
    """

    simulator: bool
    generation: str
    facts: dict[str, str]
    mode: int
    pose: SetPointValues
    distance: float

    @property
    def type_name(self) -> str:
        """Name of the robot's type; empty where the controller does not tell it."""
        return self.facts.get(TYPE_NAME_FACT, "")


class PendingCleanup(msgspec.Struct, frozen=True, tag=True):
    """What is to be ended, told before it is begun and whenever some of it is done.

    Attributes:
        debts: the oldest first.
        generation: of the controller.
        port: that we send from.
    """

    debts: tuple[CleanupTask, ...]
    generation: str
    port: int


class RealtimeReport(msgspec.Struct, frozen=True, tag=True):
    """What the system allows, as `realtime.RealtimeGrant`."""

    realtime: bool
    locked: bool
    text: str


class PlayCounts(msgspec.Struct, frozen=True):
    """What happened to set points.

    Attributes:
        sent: set points that were sent, each counted once.
        retries: further tries.
        late: replies that came after their try no longer counted.
        unanswered: set points that nothing was heard of.
        repeated: set points that were sent again since the controller's buffer was full (83201483).
        shifted: times that the schedule was put off because we were late by more than half a period.
        held: set points that waited since the controller, which should set the pace, would have gone faster.
    """

    sent: int = 0
    retries: int = 0
    late: int = 0
    unanswered: int = 0
    repeated: int = 0
    shifted: int = 0
    held: int = 0


class PlayProgress(msgspec.Struct, frozen=True, tag=True):
    """How far it is, about twenty times a second; some are left out where nobody reads them.

    Attributes:
        state: what is being done.
        index: set points of the trajectory that were sent, all rounds together.
        of: how many there will be; 0 if there is no end.
        elapsed: seconds since the first set point was sent.
        left: seconds to the last; None if there is no end.
        lateness: of all set points so far, from their deadline to when they were sent.
        counts: of what happened to them.
        commanded: the last set point.
        returned: the pose that came back last.
        sent: last frame that went out.
        received: last frame that came in.
        cycle: how many set points came how long after the one before: least and greatest ns of a bin, count.
    """

    state: PlayState
    index: int = 0
    of: int = 0
    elapsed: float = 0.0
    left: float | None = None
    lateness: Spread = Spread()
    counts: PlayCounts = PlayCounts()
    commanded: SetPointValues = ()
    returned: SetPointValues = ()
    sent: bytes = b""
    received: bytes = b""
    cycle: tuple[tuple[int, int, int], ...] = ()


class FrameMessage(msgspec.Struct, frozen=True, tag=True):
    """A frame of a call that is no set point.

    Attributes:
        sent: we sent it; else it came.
        raw: its bytes.
        time: ns since 1970.
    """

    sent: bool
    raw: bytes
    time: int


class QuestionTopic(StrEnum):
    """What a question is about."""

    BEGIN = "begin"
    """All is known that can be known without moving."""
    ARM = "arm"
    """A robot will move, for this is not the simulator."""
    APPROACH = "approach"
    """The robot is not at the first set point."""
    CLEAR = "clear"
    """The controller shows an error."""


class PlayerQuestion(msgspec.Struct, frozen=True, tag=True):
    """Something that the user has to decide; nothing happens until then.

    Attributes:
        topic: what it is about.
        text: what there is to decide.
        choices: answers; the first one does nothing.
    """

    topic: QuestionTopic
    text: str
    choices: tuple[str, ...]


class PlayerProblem(msgspec.Struct, frozen=True, tag=True):
    """Something went wrong.

    Attributes:
        text: what.
        errors: what the controller itself shows, newest first, each with its code.
    """

    text: str
    errors: tuple[tuple[int, str], ...] = ()


class PlayOutcome(StrEnum):
    """How it ended."""

    DONE = "done"
    LOOKED = "looked"
    STOPPED = "stopped"
    HALTED = "halted"
    UNARMED = "unarmed"
    DECLINED = "declined"
    UNFIT = "unfit"
    REFUSED = "refused"
    UNANSWERED = "unanswered"
    UNWRITABLE = "unwritable"
    FAILED = "failed"


class PlayEnded(msgspec.Struct, frozen=True, tag=True):
    """The last message.

    Attributes:
        outcome: how it ended.
        reason: why, in words; empty where it was done.
        lateness: of all set points, exact.
        cycle: ns from one set point to the next.
        counts: of what happened to them.
        index: set points of the trajectory that were sent.
        realtime: with real-time priority.
        left: all was let go in order; else the controller no longer answered.
        logged: records of the controller's log that were saved.
        retries_expected: the replies came over UDP and set the pace, so that retries are normal.
    """

    outcome: PlayOutcome
    reason: str = ""
    lateness: Spread = Spread()
    cycle: Spread = Spread()
    counts: PlayCounts = PlayCounts()
    index: int = 0
    realtime: bool = False
    left: bool = True
    logged: int = 0
    retries_expected: bool = False


PlayerMessage: TypeAlias = (
    ControllerInfo
    | PendingCleanup
    | RealtimeReport
    | PlayProgress
    | FrameMessage
    | PlayerQuestion
    | PlayerProblem
    | PlayEnded
)

encode_message = msgspec.json.Encoder().encode
decode_message = msgspec.json.Decoder(PlayerMessage).decode
decode_plan = msgspec.json.Decoder(PlayPlan).decode
decode_command = msgspec.json.Decoder(PlayerCommand).decode
