"""A script tries to stop the proxy: it loops, sleeps, eats memory, prints, writes to every file descriptor,
or takes most of its time for each message.

One client sends a command at which the script begins. Robot_Halt must be answered within a second, the honest
client must be answered, Ctrl-C must end the proxy, and the process of the script must end with it.
"""

from __future__ import annotations

import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from bcapscope.client import Blocking, connect, over_tcp
from bcapscope.errors import BcapError
from tests.cli.proxying import Process, proxy, simulator
from tests.security.harness import PATIENCE, Outcome, under_attack

_STUBBORN = """
import os, signal, sys, time
open({pid!r}, "w").write(str(os.getpid()))
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)

class Attack:
    def request(self, message):
        if message.command != "Attack":
            return
        while True:
            try:
                self.strike()
                return
            except BaseException:
                pass

    def strike(self):
        {body}
"""

SCRIPTS: Mapping[str, str] = {
    "loop": "while True: pass",
    "sleep": "time.sleep(3600)",
    "one long call": "sum(range(10**12))",
    "memory": "kept = []\n        while True: kept.append(bytearray(1 << 20))",
    "prints": "while True: print('x' * 10_000); print('x' * 10_000, file=sys.stderr)",
    "writes": "for number in range(3, 64):\n            try: os.write(number, b'x' * 999)\n"
    "            except OSError: pass",
    "closes": "os.closerange(3, 256)",
    "exits": "os._exit(1)",
    "crashes": "os.kill(os.getpid(), signal.SIGSEGV)",
    "stops": "os.kill(os.getpid(), signal.SIGSTOP)",
    "slow": "time.sleep(0.06)",
}
"""What the script does at the command, by name; "slow" stays within its 100 ms."""


@contextmanager
def _scripted(folder: Path, name: str) -> Iterator[Process]:
    """Run a simulator and a proxy with a script before it; check that the script's process ends."""
    path, pid = folder / "attack.py", folder / "pid"
    path.write_text(_STUBBORN.format(pid=str(pid), body=SCRIPTS[name]))
    with simulator() as sim:
        with proxy(sim.port, "-q", "--script", str(path)) as running:
            yield running
        assert not Path(f"/proc/{pid.read_text()}").exists(), "the script's process outlived the proxy"


@contextmanager
def _calls(port: int) -> Iterator[None]:
    """Send the command again and again, for the length of the block."""
    stopping = threading.Event()

    def attack() -> None:
        with Blocking() as wait:
            service = wait.enter(connect(over_tcp("127.0.0.1", port)))
            controller = wait(service.connect("", "CaoProv.DENSO.VRC", "localhost"))
            robot = wait(controller.get_robot("Attacked"))
            while not stopping.is_set():
                try:
                    wait(robot.execute("Attack"))
                except BcapError:  # there is no such command
                    time.sleep(0.001)

    thread = threading.Thread(target=attack, name="attack", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stopping.set()
        thread.join(PATIENCE)


def looping_script(name: str, seconds: float = 5.0) -> Outcome:
    """Run one of `SCRIPTS`; the honest client is measured for so many seconds without and with it."""
    with tempfile.TemporaryDirectory() as folder:
        return under_attack(f"script: {name}", _scripted(Path(folder), name), _calls, seconds=seconds)


def main() -> None:
    """Run all of them, or the one that is named."""
    for name in sys.argv[1:] or SCRIPTS:
        looping_script(name)


if __name__ == "__main__":
    main()
