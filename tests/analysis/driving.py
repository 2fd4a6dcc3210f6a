"""Clients that drive a robot in slave mode, written down by the millisecond."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

from hypothesis import strategies as st

from bcapscope.analysis.slave.session_detector import SlaveSessionDetector
from bcapscope.analysis.slave.slave_session import SlaveSession
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.traffic.call import Call, PairingResult
from bcapscope.traffic.observation import Transport
from tests.traffic.playbook import EXECUTE, SERVICE_STOP, Client, Script, text

ENTER, OFF = 0x202, 0
NOT_IN_SLAVE_MODE, UNDERFLOW, OVERFLOW, BUFFER_FULL = 0x83500121, 0x84201482, 0x83201483, 0x0F200501
NOT_ALLOWED = 0x83501032


def i4(value: int) -> Variant:
    return Variant(VT.I4, value)


def joints(*values: float) -> Variant:
    return Variant.array(VT.R8, (values + (0.0,) * 8)[:8])


def singles(*values: float) -> Variant:
    return Variant.array(VT.R4, (values + (0.0,) * 8)[:8])


class Plan:
    """What several clients of one controller do, in any order of writing."""

    def __init__(self) -> None:
        self._events: list[tuple[float, Callable[[], object]]] = []
        self.script = Script()

    def driver(self, port: int = 50001, transport: Transport = Transport.UDP, handle: int = 1) -> Driver:
        return Driver(self, self.script.client(port, transport), handle)

    def at(self, ms: float, event: Callable[[], object]) -> None:
        self._events.append((ms, event))

    def track(self, stop: int | None = None) -> list[PairingResult]:
        for _, event in sorted(self._events, key=lambda each: each[0]):
            event()
        self._events.clear()
        return self.script.track(stop)

    def stays(self, window: int | None = None) -> list[SlaveSession]:
        return watched(self.track(), window)


class Driver:
    """One client; its requests carry their own serial in reserved, as DENSO's C library does it."""

    def __init__(self, plan: Plan, client: Client, handle: int) -> None:
        self._plan = plan
        self._client = client
        self._handle = handle
        self._serial = 0

    def call(
        self,
        ms: float,
        function: int,
        *arguments: Variant,
        code: int = 0,
        results: tuple[Variant, ...] = (),
        takes: float | None = 0.5,
        retries: tuple[float, ...] = (),
    ) -> None:
        """Ask, ask again after each of `retries`, answer the last request after `takes` ms or not at all."""
        tries = [ms, *(ms + after for after in retries)]
        first = self._serial + 1
        for when in tries:
            self._serial += 1
            self._ask(when, self._serial, first, (function, arguments))
        if takes is not None:
            self._reply(tries[-1] + takes, self._serial, code, results)

    def skip_serial(self) -> None:
        """Send a request that the capture lacks."""
        self._serial += 1

    def _ask(self, ms: float, serial: int, reserved: int, question: tuple[int, tuple[Variant, ...]]) -> None:
        self._plan.at(ms, lambda: self._client.ask(ms, serial, reserved, question))

    def _reply(self, ms: float, serial: int, code: int, results: tuple[Variant, ...]) -> None:
        self._plan.at(ms, lambda: self._client.reply(ms, serial, 0, code, *results))

    def execute(
        self,
        ms: float,
        command: str,
        parameter: Variant = EMPTY,
        *,
        code: int = 0,
        result: Variant | None = EMPTY,
        takes: float | None = 0.5,
        retries: tuple[float, ...] = (),
    ) -> None:
        """Send a command to the robot."""
        arguments = i4(self._handle), text(command), parameter
        results = () if result is None else (result,)
        self.call(ms, EXECUTE, *arguments, code=code, results=results, takes=takes, retries=retries)

    def change(self, ms: float, mode: int, *, code: int = 0, takes: float | None = 0.5) -> None:
        self.execute(ms, "slvChangeMode", i4(mode), code=code, takes=takes)

    def move(
        self,
        ms: float,
        pose: Variant | None = None,
        *,
        code: int = 0,
        result: Variant | None = None,
        takes: float | None = 0.5,
        retries: tuple[float, ...] = (),
    ) -> None:
        """Send a set point; J1 moves a tenth of a degree in a millisecond unless told."""
        goal = pose if pose is not None else joints(ms / 10)
        answer = goal if result is None else result
        self.execute(ms, "slvMove", goal, code=code, result=answer, takes=takes, retries=retries)

    def moves(self, times: Iterable[float]) -> None:
        for ms in times:
            self.move(ms)

    def stop(self, ms: float) -> None:
        self.call(ms, SERVICE_STOP)


def watched(settled: Iterable[PairingResult], window: int | None = None) -> list[SlaveSession]:
    """Return the stays that a watcher finds."""
    watcher = SlaveSessionDetector(window)
    stays: list[SlaveSession] = []
    for item in settled:
        if isinstance(item, Call):
            stays += watcher.add_call(item)
    return [*stays, *watcher.remaining_sessions()]


class Step(NamedTuple):
    """One call of an arbitrary session; `takes` is None where no reply comes."""

    who: int
    after: float
    command: str
    parameter: Variant
    result: Variant
    code: int
    takes: float | None


_values = st.one_of(
    st.just(joints(1.0)),
    st.just(singles(2.0)),
    st.integers(-1, 0x204).map(i4),
    st.just(text("514")),
    st.lists(st.floats(), max_size=12).map(lambda row: Variant.array(VT.R8, tuple(row))),
    st.lists(st.integers(-1, 9).map(i4), max_size=12).map(lambda row: Variant.array(VT.VARIANT, tuple(row))),
)
_formats = ("slvRecvFormat", "slvSendFormat")
_commands = ("slvMove", "slvMove", "slvChangeMode", "slvGetMode", *_formats, "CurJnt", "\x1b[2J")
_codes = (0, 0, 0, 0, NOT_IN_SLAVE_MODE, UNDERFLOW, OVERFLOW, BUFFER_FULL, 0x80070057, 0x600B, 1)

steps = st.lists(
    st.builds(
        Step,
        who=st.integers(0, 2),
        after=st.floats(0, 40),
        command=st.sampled_from(_commands),
        parameter=_values,
        result=_values,
        code=st.sampled_from(_codes),
        takes=st.sampled_from([None, 0.1, 20.0]),
    ),
    max_size=40,
)
"""Sessions without sense."""


WINDOW = 100_000_000
"""Length of the slices of `play`, ns."""


def play(played: list[Step], release: int) -> list[SlaveSession]:
    """Play a session of three clients, of which one lets go in the middle; return the stays, with slices."""
    return watched(played_calls(played, release), WINDOW)


def played_calls(played: list[Step], release: int) -> list[PairingResult]:
    """Return the calls of `play`."""
    plan = Plan()
    drivers = [plan.driver(50001), plan.driver(50002, handle=2), plan.driver(50003, Transport.TCP)]
    now = 0.0
    for step in played:
        now += step.after
        drivers[step.who].execute(
            now, step.command, step.parameter, code=step.code, result=step.result, takes=step.takes
        )
    drivers[release].stop(now / 2)
    return plan.track()
