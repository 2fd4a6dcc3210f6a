"""Slave mode inside the controller: the buffer of set points, and what happens to them every 8 ms."""

from __future__ import annotations

from collections import deque

from bcapscope.protocol.slave_mode.formats import POSE_ONLY_FORMAT, ReceiveFormat
from bcapscope.protocol.slave_mode.modes import PERIOD_NS, ModeKind, SlaveMode
from bcapscope.protocol.tables.hresult import E_SLAVE_OVERFLOW, E_SLAVE_UNDERFLOW
from bcapscope.simulator.arm import Arm
from bcapscope.simulator.call_outcome import RefusalCode, RefusedError
from bcapscope.simulator.kinematics import AXIS_COUNT, AXIS_LIMITS, AxisLimit, Joints

MOVING_THRESHOLD = 0.01
"""An axis counts as moving if it moves by more than this number of degrees in 8 ms. Assumed."""

_TOLERANCE = 1.000001  # tolerance for set points that were rounded to single precision


class SlaveDrive:
    """Consumes one set point every 8 ms while slave mode is on.

    Attributes:
        run_number: Number of slave-mode sessions so far.
        consumed: Number of set points consumed in this slave-mode session.
        async_detector: Whether a late set point is an error in RC7's Async modes; a setting on the pendant.
        unreported_result: Result that ended slave mode and that no client has received yet; 0 for none.
    """

    def __init__(self, arm: Arm, limits: tuple[AxisLimit, ...] = AXIS_LIMITS) -> None:
        self.mode: SlaveMode | None = None
        self.run_number = 0
        self.consumed = 0
        self.next_tick = 0
        self.send_format = POSE_ONLY_FORMAT
        self.receive_format: ReceiveFormat | None = None
        self.unreported_result = 0
        self.async_detector = False
        self._arm = arm
        self._limits = limits
        self._queue: deque[Joints] = deque()
        self._speed: Joints = (0.0,) * 8
        self._moving = False
        self._leaving = False

    @property
    def waiting(self) -> int:
        return len(self._queue)

    @property
    def is_empty(self) -> bool:
        """Whether the buffer is empty and the last set point did not move an axis."""
        return not self._queue and not self._moving

    def enter(self, mode: SlaveMode, now: int) -> None:
        self.mode = mode
        self.run_number += 1
        self.unreported_result = 0
        self.consumed = 0
        self.next_tick = now + PERIOD_NS
        self._queue.clear()
        self._clear_speed()
        self._leaving = False
        self._arm.begin_set_points(now)

    def drain(self) -> None:
        """From now on, an empty buffer is not an error."""
        self._leaving = True

    def leave(self, unreported_result: int = 0) -> None:
        if self.mode is not None:
            self.unreported_result = unreported_result
        self.mode = None
        self._queue.clear()

    def push(self, joints: Joints) -> int:
        """Return how many set points must be `consumed` before slvMove may answer.

        A full buffer refuses the set point in modes that do not make the client wait.
        """
        mode = self.mode
        assert mode is not None
        if mode.overwrites_waiting and self._queue:
            self._queue[-1] = joints
            return 0
        if mode.overflow_is_error and len(self._queue) >= mode.buffer_slots:
            raise RefusedError(E_SLAVE_OVERFLOW)
        self._queue.append(joints)
        place = self.consumed + len(self._queue)
        if not mode.paces_client:
            return 0
        return place if mode.kind is ModeKind.SYNC else place - mode.buffer_slots

    def advance(self, now: int) -> int | None:
        """Consume the due set points. At an error, return its code; `next_tick` is then the error's time."""
        while self.mode is not None and self.next_tick <= now:
            if self.is_empty:
                self.next_tick += ((now - self.next_tick) // PERIOD_NS + 1) * PERIOD_NS
                break
            code = self._tick(self.mode)
            if code:
                return code
            self.next_tick += PERIOD_NS
        return None

    def _tick(self, mode: SlaveMode) -> int:
        here = self._arm.goal
        if not self._queue:
            self._clear_speed()
            detects = self.async_detector if mode.underflow_is_error is None else mode.underflow_is_error
            return E_SLAVE_UNDERFLOW if detects and not self._leaving else 0
        goal = tuple(map(float, self._queue.popleft()))  # clients also send integers
        self.consumed += 1
        speed = tuple(b - a for a, b in zip(here, goal, strict=True))
        code = self._limit_violation(speed)
        self._speed = speed
        self._moving = any(abs(each) > MOVING_THRESHOLD for each in speed)
        if not code:
            self._arm.add_set_point(goal, self.next_tick - PERIOD_NS, self.next_tick)
        return code

    def _clear_speed(self) -> None:
        self._speed = (0.0,) * 8
        self._moving = False

    def _limit_violation(self, speed: Joints) -> int:
        seconds = PERIOD_NS / 1e9
        for axis in range(AXIS_COUNT):
            limit = self._limits[axis]
            if abs(speed[axis]) > limit.speed * seconds * _TOLERANCE:
                return RefusalCode.SPEED_LIMIT + axis + 1
            if abs(speed[axis] - self._speed[axis]) > limit.acceleration * seconds**2 * _TOLERANCE:
                return RefusalCode.ACCELERATION_LIMIT + axis + 1
        return 0
