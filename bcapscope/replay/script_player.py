"""Make the calls of a `ReplayScript` to a controller, with the handles that this controller gives."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

from bcapscope.client.handle_table import first_number
from bcapscope.client.object_opener import ObjectOpener
from bcapscope.errors import BcapError, ControllerError
from bcapscope.messages import Message
from bcapscope.player.blocking_caller import Channel
from bcapscope.player.motion_checks import POSITION_TOLERANCE
from bcapscope.player.robot_adapter import RobotAdapter, pose_distance
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.requester import CallAnswered, CallTimedOut, RequesterOutcome
from bcapscope.protocol.slave_mode.modes import pose_type_of_mode
from bcapscope.protocol.slave_mode.poses import pose_numbers
from bcapscope.protocol.tables.command_catalogue import command_parameter
from bcapscope.protocol.tables.function_table import FUNCTIONS, ObjectClass, ResultKind
from bcapscope.protocol.tables.hresult import is_failure, is_success
from bcapscope.replay.replay_script import ReplayScript, ScriptCall
from bcapscope.replay.set_point_runs import mode_entered

ABSOLUTE_TOLERANCE, RELATIVE_TOLERANCE = 1e-3, 1e-4
"""Numbers within these tolerances count as equal. A robot never returns exactly the same values twice."""


class NotAtStartError(BcapError):
    """The robot is not at the first set point of the recording, or its position is unknown."""


class PlayedCall(NamedTuple):
    """A call of a `ReplayScript`, and its result in the replay.

    `delay` is the time in ns by which the call began late, because earlier calls took longer than recorded.
    """

    script_call: ScriptCall
    arguments: tuple[Variant, ...]
    result: RequesterOutcome
    delay: int

    @property
    def differs(self) -> bool:
        """Whether recorded and played call have different result codes, or only one of them has a reply."""
        result = self.result
        return self.script_call.hresult != (None if isinstance(result, CallTimedOut) else result.reply.code)

    @property
    def values_differ(self) -> bool:
        """Whether the result codes are equal, but the returned values differ by more than the tolerance."""
        call, result = self.script_call, self.result
        if isinstance(result, CallTimedOut) or result.reply.code != call.hresult:
            return False
        function = FUNCTIONS.get(call.kind.function_id)
        if function is not None and function.result is ResultKind.HANDLE:
            return False
        return not _nearly_equal(call.values, result.reply.variants)

    @property
    def failed(self) -> bool:
        then = self.script_call.hresult is not None and is_success(self.script_call.hresult)
        return then and not isinstance(self.result, CallAnswered)

    @property
    def unanswered(self) -> bool:
        return self.script_call.hresult is not None and isinstance(self.result, CallTimedOut)


class ScriptPlayer:
    """Plays a script.

    A recording may use objects that were opened before it began; `ObjectOpener` opens these objects. At the
    end of the replay, the client session releases the objects that the recording leaves open.
    """

    def __init__(
        self,
        script: ReplayScript,
        opener: ObjectOpener,
        channel: Channel,
        longest_pause: int,
        anywhere: bool = False,
    ) -> None:
        """The player shortens longer pauses to `longest_pause` ns. `anywhere` allows slave mode even if the
        robot is not at the first set point.
        """
        self._script = script
        self._opener = opener
        self._channel = channel
        self._longest_pause = longest_pause
        self._anywhere = anywhere
        self._handles: dict[tuple[ObjectClass, int], int] = {}

    async def play(self, on_played: Callable[[PlayedCall], bool]) -> None:
        """Play the script to its end, or until `on_played` returns False.

        Raises NotAtStartError and OSError. Raises ValueError if the name of an object in the script is
        unknown. Raises BcapError if the player cannot open an object, or cannot send a call.
        """
        channel = self._channel
        start = channel.now()
        for place, (line, at) in enumerate(zip(self._script.calls, self._send_times(), strict=True)):
            arguments = await self._current_arguments(line)
            if arguments is None:
                continue
            if not self._anywhere:
                await self._check_start(place)
            channel.wait_until(start + at)
            late = channel.now() - start - at
            settled = await self._opener.session.perform_call(line.kind.function_id, arguments)
            self._learn_handle(line, settled)
            if not on_played(PlayedCall(line, arguments, settled, late)):
                return

    def _send_times(self) -> Iterator[int]:
        """Yield the planned time of each call, in ns after the start of the replay."""
        at = last = 0
        for line in self._script.calls:
            at += min(line.offset - last, self._longest_pause)
            last = line.offset
            yield at

    async def _current_arguments(self, call: ScriptCall) -> tuple[Variant, ...] | None:
        """Replace the recorded handle. Return None if the call releases an object that is not open."""
        function = FUNCTIONS.get(call.kind.function_id)
        old = first_number(call.arguments)
        if function is None or not function.takes_handle or old is None:
            return call.arguments
        owner = function.owner
        new = self._handles.get((owner, old))
        if new is None and call.hresult is not None and is_failure(call.hresult):
            # The recorded controller refused this call, perhaps because of an invalid handle. Send the
            # recorded handle again.
            return call.arguments
        if new is None and function.releases is not None:
            return None
        if new is None:
            new = self._handles[owner, old] = await self._opener.handle_for(owner)
        return (Variant(VT.I4, new), *call.arguments[1:])

    async def _check_start(self, place: int) -> None:
        """Before a call that enters slave mode, check that the robot is at the first set point."""
        mode = mode_entered(self._script.calls[place])
        kind = None if mode is None else pose_type_of_mode(mode)
        if kind is None:
            return
        moves = (line for line in self._script.calls[place + 1 :] if line.kind.folded_command == "slvmove")
        first = next(moves, None)
        parameter = None if first is None else command_parameter(first.arguments)
        goal = None if parameter is None else pose_numbers(parameter)
        if first is None or goal is None:
            return
        try:
            here = await RobotAdapter(self._opener, self._pause).read_pose(kind)
        except ControllerError as error:
            raise NotAtStartError(Message("replay.position-unknown", reason=error.message)) from None
        far = pose_distance(kind, here, goal)
        if far > POSITION_TOLERANCE:
            raise NotAtStartError(Message("replay.not-at-start", call=first.number, distance=f"{far:.3g}"))

    def _pause(self, length: int) -> None:
        self._channel.wait_until(self._channel.now() + length)

    def _learn_handle(self, call: ScriptCall, result: RequesterOutcome) -> None:
        function = FUNCTIONS.get(call.kind.function_id)
        if function is None or function.creates is None or not isinstance(result, CallAnswered):
            return
        then = first_number(call.values)
        now = first_number(result.reply.variants)
        if then is not None and now is not None:
            self._handles[function.creates, then] = now


def _nearly_equal(first: object, second: object) -> bool:
    """Numbers may differ by the tolerance; a `Variant` is compared as a tuple."""
    if isinstance(first, float) and isinstance(second, float):
        same = math.isclose(first, second, rel_tol=RELATIVE_TOLERANCE, abs_tol=ABSOLUTE_TOLERANCE)
        return same or (math.isnan(first) and math.isnan(second))
    if isinstance(first, tuple) and isinstance(second, tuple):
        return len(first) == len(second) and all(map(_nearly_equal, first, second))
    return first == second
