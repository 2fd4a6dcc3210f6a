"""The messages between the player's process and its parent: JSON, one object per line.

The parent sends the `PlayPlan` first, then orders. The player sends facts, progress, questions and finally
one `PlayEnded`.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import Any, TypeAlias

import msgspec

from bcapscope.client.controller_target import DEFAULT_ROBOT, ROBSLAVE, ControllerTarget
from bcapscope.messages import Message
from bcapscope.messages.message_codec import message_from_data, message_to_data
from bcapscope.player.lateness import Spread
from bcapscope.player.realtime import RealtimeReport
from bcapscope.protocol.slave_mode.modes import (
    PERIOD_NS,
    Generation,
    PoseType,
    SlaveMode,
    slave_mode_by_number,
)

SetPointValues: TypeAlias = tuple[float, ...]
"""Numbers of one set point, in the order and units of its pose type (`protocol.slave_mode.poses.AXES`)."""


TYPE_NAME_FACT = "type name"
"""Key of the fact that holds the name of the robot's type."""


class SlaveModePacing(StrEnum):
    """Kind of slave mode that controllers of all generations have, under different numbers."""

    SYNC = "sync"
    """The controller sets the pace: Sync on RC7, mode 2 on later ones."""
    ASYNC = "async"
    """The player sets the pace, and the newest set point wins: Async on RC7, mode 1 on later ones."""


class CleanupTask(StrEnum):
    """Something that the player begins and must undo, whatever happens."""

    ROBSLAVE = "RobSlave"
    ARM = "arm"
    MOTOR = "motor"
    MOTION = "motion"
    """The ordinary motion to the first point, which continues without the player."""
    LOG = "log"
    SLAVE_MODE = "slave mode"


class PendingCleanup(msgspec.Struct, frozen=True, tag=True):
    """What must be undone; sent before each step begins and whenever a cleanup task is done.

    Attributes:
        debts: Cleanup tasks, oldest first.
        generation: Generation of the controller.
        port: Local port of the player. A controller knows a UDP client by its port, so a process that cleans
            up continues the conversation from there.
    """

    debts: tuple[CleanupTask, ...]
    generation: str
    port: int


class PlayPlan(msgspec.Struct, frozen=True, kw_only=True):
    """What to play and where.

    Attributes:
        robot: Name for Controller_GetRobot.
        task: Name of the program that RC7 needs for slave mode.
        mode: Kind of slave mode, or the exact number for slvChangeMode.
        period: Time between set points, ns, where the controller's reply does not decide it.
        points: Set points; the robot rests at the first and the last. Missing axes keep their position.
        limits: Limits of the arm as `arm_limits.with_limits` accepts them; a stop keeps within them.
        rounds: How often to play the set points, the first following the last; 0 to play until an order to
            stop.
        approach: Speed of the ordinary motion to the first point, percent.
        may_approach: Whether to approach without asking.
        armed: Whether the user has confirmed that a robot will move.
        look_only: Connect, report facts and end; nothing moves and nothing changes.
        log: Path of a new CSV file for the controller's own log; None for no log.
        record: Path of a new recording of all frames; None for none.
        aftermath: Only undo what this crashed player left, and play nothing; None to play.
        first_serial: First serial to use, beyond any that a crashed player can have used.
    """

    target: ControllerTarget
    robot: str = DEFAULT_ROBOT
    task: str = ROBSLAVE
    kind: PoseType = PoseType.J
    mode: SlaveModePacing | int = SlaveModePacing.SYNC
    period: int = PERIOD_NS
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
    aftermath: PendingCleanup | None = None
    first_serial: int = 1


class Order(StrEnum):
    """An order to the player while it works."""

    STOP = "stop"
    """Come to rest on the way, then clean up."""
    HALT = "halt"
    """Halt the arm at once, then clean up."""


class PlayerCommand(msgspec.Struct, frozen=True):
    """An order, or the answer to the last question."""

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

    @property
    def message(self) -> Message:
        return Message(f"player.state.{self.name.lower()}")


class ControllerInfo(msgspec.Struct, frozen=True, tag=True):
    """The controller that answered.

    Attributes:
        simulator: Whether it is bcapscope's simulator; then no robot moves.
        generation: RC7, or RC8 for all later ones.
        mode: Slave mode that the player will use.
        pose: Current pose of the robot, in the pose type of the set points.
        distance: Distance to the first point: the largest difference of any axis, degrees or mm.
    """

    simulator: bool
    generation: str
    facts: dict[str, str]
    mode: int
    pose: SetPointValues
    distance: float

    @property
    def type_name(self) -> str:
        """Name of the robot's type; empty if the controller does not report it."""
        return self.facts.get(TYPE_NAME_FACT, "")

    @property
    def slave_mode(self) -> SlaveMode | None:
        """The slave mode that the player will use; None if the controller has none of this number."""
        return slave_mode_by_number(self.mode, Generation(self.generation))


class PlayCounts(msgspec.Struct, frozen=True):
    """Counts about the set points.

    Attributes:
        sent: Set points sent, without retries; one sent again because the buffer was full counts again.
        retries: Retries.
        late: Late replies.
        unanswered: Set points without any reply.
        repeated: Set points sent again because the controller's buffer was full (83201483).
        shifted: How often the pacer moved the deadlines because it was late by more than half a period.
        held: Set points delayed because the controller, which should set the pace, asked for them too soon.
    """

    sent: int = 0
    retries: int = 0
    late: int = 0
    unanswered: int = 0
    repeated: int = 0
    shifted: int = 0
    held: int = 0


class PlayProgress(msgspec.Struct, frozen=True, tag=True):
    """Progress, about twenty times a second; the player drops reports that nobody reads.

    Attributes:
        index: Set points of the trajectory sent so far, all rounds together.
        of: Total number of set points; 0 if there is no end.
        elapsed: Seconds since the first set point.
        left: Seconds until the last set point; None if there is no end.
        lateness: Time from the deadline of each set point to its sending, so far.
        commanded: The last set point.
        returned: The pose in the last reply.
        sent: The last frame sent.
        received: The last frame received.
        cycle: Histogram of the time between set points: least and greatest ns of a bin, count.
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
    """A frame of a call that is no set point; `sent` by the player or received, at `time`, ns since 1970."""

    sent: bool
    raw: bytes
    time: int


class QuestionTopic(StrEnum):
    BEGIN = "begin"
    """Begin? Everything that can be known without motion is known."""
    ARM = "arm"
    """A robot will move, because this is not the simulator."""
    APPROACH = "approach"
    """The robot is not at the first set point."""
    CLEAR = "clear"
    """The controller shows an error."""


class PlayerQuestion(msgspec.Struct, frozen=True, tag=True):
    """A decision for the user, for which the player waits; the first choice does nothing."""

    topic: QuestionTopic
    text: Message
    choices: tuple[str, ...]


class PlayerProblem(msgspec.Struct, frozen=True, tag=True):
    """A problem, with the errors that the controller shows, newest first: code and text."""

    text: Message
    errors: tuple[tuple[int, str], ...] = ()


class PlayOutcome(StrEnum):
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
        reason: Why; None if everything was done.
        lateness: Lateness of all set points, exact.
        cycle: Time between set points, ns, exact.
        index: Set points of the trajectory sent.
        realtime: Whether the player had real-time priority.
        left: Whether the cleanup ran; False if the controller no longer answered.
        logged: Records of the controller's log that were saved.
        retries_expected: The replies came over UDP and set the pace, so retries are normal.
    """

    outcome: PlayOutcome
    reason: Message | None = None
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


def _to_data(value: object) -> object:
    if isinstance(value, Message):
        return message_to_data(value)
    raise NotImplementedError(f"{type(value)} crosses no pipe")  # msgspec expects this for an unknown type


def _from_data(kind: type, data: Any) -> object:
    if kind is Message:
        return message_from_data(data)
    raise NotImplementedError(f"{kind} crosses no pipe")


encode_message = msgspec.json.Encoder(enc_hook=_to_data).encode
decode_message = msgspec.json.Decoder(PlayerMessage, dec_hook=_from_data).decode
decode_plan = msgspec.json.Decoder(PlayPlan).decode
decode_command = msgspec.json.Decoder(PlayerCommand).decode
