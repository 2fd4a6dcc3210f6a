"""How long `bcapscope --help` takes on a warm disk, beside a Python that does nothing.

Run from the project's root as ``python -m tests.bench.start``.
"""

from __future__ import annotations

import subprocess
import sys
import time
from statistics import median

RUNS = 25
COMMANDS = {
    "python -c pass": (sys.executable, "-c", "pass"),
    "bcapscope --help": (sys.executable, "-m", "bcapscope", "--help"),
    "bcapscope decode --help": (sys.executable, "-m", "bcapscope", "decode", "--help"),
}


def milliseconds(argv: tuple[str, ...]) -> float:
    """Run the command once and return how long it took."""
    began = time.perf_counter()
    subprocess.run(argv, check=True, stdout=subprocess.DEVNULL)
    return (time.perf_counter() - began) * 1e3


def main() -> None:
    """Print median and worst of each command, started in turn; the first, cold round does not count."""
    rounds = [{name: milliseconds(argv) for name, argv in COMMANDS.items()} for _ in range(RUNS + 1)][1:]
    for name in COMMANDS:
        taken = [found[name] for found in rounds]
        print(f"{name:26} median {median(taken):6.1f} ms   worst {max(taken):6.1f} ms")


if __name__ == "__main__":
    main()
