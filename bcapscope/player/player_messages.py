"""The messages between the player's process and its parent: JSON, one object per line.

The parent sends one `PlayPlan`, then a `PlayerCommand` for each order and answer. The player's last message
is `PlayEnded`.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import TypeAlias

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
"""Numbers of one set point in the order and units of its axes (`protocol.slave_mode.poses.AXES`)."""


TYPE_NAME_FACT = "type name"
"""Key of the robot's type name in `ControllerInfo.facts`."""


class SlaveModePacing(StrEnum):
    """Kind of slave mode. The mode numbers of each kind depend on the generation of the controller."""

    SYNC = "sync"
    """The controller sets the pace: Sync on RC7, mode 2 on later controllers."""
    ASYNC = "async"
    """The player sets the pace: Async on RC7, mode 1 on later controllers."""


class CleanupTask(StrEnum):
    """What the player must undo at the end of the session, even after an error."""

    ROBSLAVE = "RobSlave"
    ARM = "arm"
    MOTOR = "motor"
    MOTION = "motion"
    """The motion to the first point. The robot completes this motion even if the player ends."""
    LOG = "log"
    SLAVE_MODE = "slave mode"


class PendingCleanup(msgspec.Struct, frozen=True, tag=True):
    """What the player must still clean up. The player sends this message whenever the tasks change.

    Attributes:
        debts: Cleanup tasks that remain, oldest first.
        port: Local port of the player. A cleanup after a crash uses the same port, because the controller
            recognises a UDP client by its port.
    """

    debts: tuple[CleanupTask, ...]
    generation: str
    port: int


class PlayPlan(msgspec.Struct, frozen=True, kw_only=True):
    """What to play, and on which controller.

    Attributes:
        task: Name of the controller's program that must run during slave mode on RC7.
        mode: Kind of slave mode, or the exact number for slvChangeMode.
        period: Time in ns between set points in the modes where the player sets the pace.
        points: Set points of the trajectory, which begins and ends at rest. Missing axes do not move.
        limits: Limits that a stop does not exceed, in the notation of `arm_limits.with_limits`.
        rounds: How often to play the set points, without a pause; 0 to play until an order to stop.
        approach: Speed, in percent, of the ordinary motion to the first point.
        may_approach: Whether to move to the first point without asking the user.
        armed: Whether the user has confirmed that a robot may move.
        look_only: Whether the player only reports facts about the controller, and changes nothing.
        log: Path of a new CSV file for the controller's own log.
        record: Path of a new recording of all frames.
        aftermath: Cleanup tasks of a crashed player. With `aftermath`, the player only cleans up.
        first_serial: After a crash, a serial that the crashed player did not use.
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
    STOP = "stop"
    """Bring the robot to rest on its path, then clean up."""
    HALT = "halt"
    """Halt the arm at once, then clean up."""


class PlayerCommand(msgspec.Struct, frozen=True):
    order: Order | None = None
    answer: str = ""


class PlayState(StrEnum):
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
        simulator: Whether the controller is bcapscope's simulator, so that no real robot moves.
        generation: RC7, or RC8 for all later generations.
        mode: Slave mode that the player will use.
        pose: Current pose of the robot, in the pose type of the set points.
        distance: Largest difference of one axis to the first point, in degrees or mm.
    """

    simulator: bool
    generation: str
    facts: dict[str, str]
    mode: int
    pose: SetPointValues
    distance: float

    @property
    def type_name(self) -> str:
        return self.facts.get(TYPE_NAME_FACT, "")

    @property
    def slave_mode(self) -> SlaveMode | None:
        return slave_mode_by_number(self.mode, Generation(self.generation))


class PlayCounts(msgspec.Struct, frozen=True):
    """Counts of set points.

    Attributes:
        sent: Set points that were sent, without retries but with the `repeated` set points.
        repeated: Set points sent again because the controller's buffer was full (83201483).
        shifted: How often the deadlines moved because a set point was late by more than half a period.
        held: Set points that were delayed because the controller requested them too soon.
    """

    sent: int = 0
    retries: int = 0
    late: int = 0
    unanswered: int = 0
    repeated: int = 0
    shifted: int = 0
    held: int = 0


class PlayProgress(msgspec.Struct, frozen=True, tag=True):
    """The player reports its progress about twenty times a second, unless the pipe is full.

    Attributes:
        index: How many of the trajectory's set points were sent so far, in all rounds.
        of: Total number of set points in all rounds; 0 if the play has no end.
        elapsed: Seconds since the first set point.
        left: Seconds until the last set point; None if the play has no end.
        lateness: Distribution of the time from each set point's deadline to its sending.
        commanded: The last set point sent; `returned` is the pose in the last reply.
        sent: The last frame sent; `received` is the last frame received.
        cycle: Histogram of the time between set points: smallest time and largest time in ns, and count.
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
    """A frame of a call other than slvMove; the player sent or received it at `time`, ns since 1970."""

    sent: bool
    raw: bytes
    time: int


class QuestionTopic(StrEnum):
    BEGIN = "begin"
    """All checks that need no motion are done; may the play begin?"""
    ARM = "arm"
    """The controller is not the simulator, so a real robot will move; may the robot move?"""
    APPROACH = "approach"
    """The robot is not at the first set point; may an ordinary motion bring it there?"""
    CLEAR = "clear"
    """The controller shows an error; should the player clear it?"""


class PlayerQuestion(msgspec.Struct, frozen=True, tag=True):
    """A question to the user. The first choice changes nothing."""

    topic: QuestionTopic
    text: Message
    choices: tuple[str, ...]


class PlayerProblem(msgspec.Struct, frozen=True, tag=True):
    """A problem, with code and text of the controller's current errors, newest first."""

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
    """The last message of a player. The distributions are in ns, and are estimates if the play had too many
    set points.

    Attributes:
        reason: Why the player ended; None if the player sent the whole trajectory.
        cycle: Distribution of the time between set points.
        index: Number of the trajectory's set points that the player sent.
        left: Whether the player cleaned up before leaving; False if the controller no longer answered.
        logged: Number of records of the controller's log that the player saved.
        retries_expected: Whether retries are normal: over UDP, if the controller's replies set the pace.
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


encode_message = msgspec.json.Encoder(enc_hook=message_to_data).encode
decode_message = msgspec.json.Decoder(
    PlayerMessage, dec_hook=lambda kind, data: message_from_data(data)
).decode
decode_plan = msgspec.json.Decoder(PlayPlan).decode
decode_command = msgspec.json.Decoder(PlayerCommand).decode
