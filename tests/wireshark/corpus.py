"""Examples of hypothesis strategies as a list, for programs that take many at once.

Run as a program, this module writes the examples of a strategy of `tests.strategies` as hexadecimal lines.
"""

from __future__ import annotations

import subprocess
import sys
from functools import cache
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings

from tests import strategies


@cache
def corpus(strategy: str, count: int, number: int = 5007) -> tuple[bytes, ...]:
    """Draw `count` examples of a strategy in `tests.strategies`; the same `number` gives the same examples.

    Hypothesis takes some values from the constants of all loaded modules of the project. A new process draws
    the examples, so that the same modules are loaded in every test run.
    """
    argv = [sys.executable, "-m", "tests.wireshark.corpus", strategy, str(count), str(number)]
    folder = Path(__file__).parents[2]
    done = subprocess.run(argv, capture_output=True, check=True, cwd=folder, text=True)
    return tuple(map(bytes.fromhex, done.stdout.splitlines()))


def _print_examples(strategy: str, count: int, number: int) -> None:
    @seed(number)
    @settings(
        max_examples=count,
        phases=[Phase.generate],
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(getattr(strategies, strategy)())
    def draw(data: bytes) -> None:
        sys.stdout.write(data.hex() + "\n")

    draw()


if __name__ == "__main__":
    _print_examples(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
