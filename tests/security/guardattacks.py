"""Requests that energise or move, in every disguise, against ``proxy --read-only``: the robot stays still.

Run it with ``python -m tests.security.guardattacks``. The same requests through a proxy without a guard must
energise the robot, or the attack proves nothing.
"""

from __future__ import annotations

import random
import socket
import struct
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import NamedTuple

from bcapscope.client import Blocking, connect, over_tcp
from bcapscope.protocol.codec.frame import Frame, encode_frame, parse_datagram
from bcapscope.protocol.codec.variant import VT, Value, Variant
from bcapscope.protocol.tables.function_table import ID
from tests.cli.proxying import Process, proxy, simulator
from tests.proxy.evasions import Ends, evasion
from tests.security.harness import PATIENCE, TRANSPORTS, Outcome, under_attack

_PER_CONNECTION = 8
"""Evasions over one TCP connection: a wrong length makes the proxy wait for what never comes."""

_REPLY = 0.002
"""Seconds that the attacker waits for a reply, which it does not read."""


class RobotState(NamedTuple):
    """What a robot shows that nobody may have touched."""

    servo_on: object
    joints: object
    slave_mode: object
    external_speed: object
    errors: object


def robot_state(port: int) -> RobotState:
    """Ask a simulator itself, past the proxy."""
    with Blocking() as wait:
        service = wait.enter(connect(over_tcp("127.0.0.1", port)))
        controller = wait(service.connect("", "CaoProv.DENSO.VRC", "localhost"))
        robot = wait(controller.get_robot("Arm"))
        variable = wait(robot.get_variable("@SERVO_ON"))
        state = RobotState(
            wait(variable.get_value()),
            wait(robot.execute("CurJnt")),
            wait(robot.slv_get_mode()),
            wait(robot.execute("CurExtSpd")),
            wait(controller.execute("GetCurErrorCount")),
        )
    return state


class Attacker:
    """A client that opens what its requests need, and then sends whatever bytes it likes."""

    def __init__(self, port: int, transport: str) -> None:
        kind = socket.SOCK_STREAM if transport == "tcp" else socket.SOCK_DGRAM
        self._socket = socket.socket(socket.AF_INET, kind)
        self._is_udp = transport == "udp"
        self._serial = 0
        self.ends = Ends(0, 0, 0)
        try:
            self._socket.connect(("127.0.0.1", port))
            self.open()
        except BaseException:
            self._socket.close()
            raise

    def open(self) -> None:
        """Begin a session, anew if there is one, and note its handles."""
        self._socket.settimeout(0.2 if self._is_udp else PATIENCE)
        none = Variant(VT.BSTR, "")
        if self.ends.robot:
            self._call("Service_Stop")  # with all that was opened
        self._call("Service_Start", none)
        provider, machine = Variant(VT.BSTR, "CaoProv.DENSO.VRC"), Variant(VT.BSTR, "localhost")
        controller = self._call("Controller_Connect", none, provider, machine, none)
        robot = self._call("Controller_GetRobot", controller, Variant(VT.BSTR, "Arm"), none)
        servo_on = self._call("Robot_GetVariable", robot, Variant(VT.BSTR, "@SERVO_ON"), none)
        self._socket.settimeout(_REPLY)
        self.ends = Ends(*(_number(each.value) for each in (controller, robot, servo_on)))

    def _call(self, name: str, *arguments: Variant) -> Variant:
        """Make an honest call; over UDP as often as it takes."""
        first = self._serial + 1
        for _ in range(20 if self._is_udp else 1):
            self._serial += 1
            self._socket.send(encode_frame(self._serial, 0, ID[name], arguments))
            with suppress(TimeoutError, ConnectionRefusedError):
                while True:
                    data = self._socket.recv(65536)
                    if not data:
                        raise ConnectionResetError(name)
                    reply = parse_datagram(data)[-1]
                    if isinstance(reply, Frame) and first <= reply.serial <= self._serial:
                        assert reply.code == 0 or name == "Service_Stop", f"{name}: {reply.code:08X}"
                        return reply.variants[0] if reply.variants else Variant(VT.EMPTY, None)
        raise AssertionError(f"{name} {self._serial} of {self._socket.getsockname()} was not answered")

    def send(self, raw: bytes) -> None:
        """Send bytes with a serial that is new, so that they count as a request of their own."""
        self._serial = self._serial % 0xFFFF + 1
        self._socket.send(raw[:5] + struct.pack("<H", self._serial) + raw[7:])
        with suppress(TimeoutError):
            self._socket.recv(65536)

    def close(self) -> None:
        """End the connection without a word."""
        self._socket.close()


def attack(port: int, transport: str, rng: random.Random, more: Callable[[], bool]) -> Counter[str]:
    """Send evasions while `more` says so; return how many there were of each disguise."""
    sent: Counter[str] = Counter()
    attacker = None
    while more():
        try:
            if attacker is None:
                attacker = Attacker(port, transport)
            else:
                attacker.open()
            for _ in range(_PER_CONNECTION):
                name, raw = evasion(rng, attacker.ends)
                attacker.send(raw)
                sent[name] += 1
        except OSError:
            pass  # the proxy or the simulator closed the connection
        if transport == "tcp" and attacker is not None:
            attacker.close()
            attacker = None
    if attacker is not None:
        attacker.close()
    return sent


@contextmanager
def attacking(port: int, seed: int) -> Iterator[Counter[str]]:
    """Attack over both transports at once while the block runs."""
    stopping = threading.Event()
    sent: Counter[str] = Counter()
    failed: list[BaseException] = []

    def run(transport: str) -> None:
        try:
            sent.update(attack(port, transport, random.Random(seed), lambda: not stopping.is_set()))
        except BaseException as error:
            failed.append(error)

    threads = [threading.Thread(target=run, args=(each,), daemon=True) for each in TRANSPORTS]
    for thread in threads:
        thread.start()
    try:
        yield sent
    finally:
        stopping.set()
        for thread in threads:
            thread.join(PATIENCE)
    assert not failed, failed
    assert not any(thread.is_alive() for thread in threads)


def guard_attacks(seconds: float = 10.0, seed: int = 1) -> Outcome:
    """Attack a read-only proxy for so long; the robot behind it must stay as it was."""
    with simulator() as robot:
        before = robot_state(robot.port)

        @contextmanager
        def untouched(port: int) -> Iterator[None]:
            with attacking(port, seed) as sent:
                yield
            assert robot_state(robot.port) == before, (before, robot_state(robot.port))
            assert len(sent) > 10, sent
            print(f"guardattacks: {sent.total()} requests in {len(sent)} disguises passed by the robot")

        return under_attack("guardattacks", _read_only(robot.port), untouched, seconds=seconds)


def _read_only(port: int) -> AbstractContextManager[Process]:
    return proxy(port, "--read-only", "-q")


def unguarded(connections: int = 100, seed: int = 1) -> int:
    """Send the same requests through a proxy without a guard; return how many it took to affect the robot."""
    with simulator() as robot, proxy(robot.port, "-q") as relay:
        before = robot_state(robot.port)
        left = iter(range(connections))
        sent = attack(
            relay.port,
            "tcp",
            random.Random(seed),
            lambda: robot_state(robot.port) == before and next(left, None) is not None,
        )
        assert robot_state(robot.port) != before, "the requests do nothing"
        return sent.total()


def _number(value: Value) -> int:
    assert isinstance(value, int)
    return value


def main() -> None:
    """Attack, and show that the attack is one."""
    try:
        guard_attacks()
        print(f"guardattacks: without a guard {unguarded()} requests affected the robot")
    except AssertionError as error:
        print(f"guardattacks: {error}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
