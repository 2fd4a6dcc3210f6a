"""How much a script adds to a round trip through the proxy, at 125 round trips a second.

Run from the project's root as ``python -m tests.bench.scripts``. It prints the medians of some runs each:
without rules, with a fault that strikes nothing, and with scripts of different hooks.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from statistics import median

from tests.bench.proxy import free_port, percentile, running, trips
from tests.cli.proxying import proxy

RUNS, TRIPS, PACE = 3, 1000, 0.008

_HOOK = "    def {hook}(self, message):\n        self.last = message.function\n"
SCRIPTS = {"settled": ("settled",), "request": ("request",), "request and reply": ("request", "reply")}


def main() -> None:
    """Measure all ways in turn."""
    found: dict[str, list[list[int]]] = {}
    server = free_port()
    with (
        tempfile.TemporaryDirectory() as folder,
        running(sys.executable, "-m", "tests.bench.proxy", "echo", str(server), settle=1.0),
    ):
        ways: dict[str, tuple[str, ...]] = {"no rules": (), "a fault": ("--fault", "drop if serial == 70000")}
        for name, hooks in SCRIPTS.items():
            path = Path(folder) / f"{hooks[0]}{len(hooks)}.py"
            hooked = "".join(_HOOK.format(hook=hook) for hook in hooks)
            path.write_text("class Script:\n" + hooked.replace("message.function", "message.call_kind"))
            ways[f"script: {name}"] = "--script", str(path)
        for _ in range(RUNS):
            for name, words in ways.items():
                with proxy(server, "-q", *words) as relay:
                    found.setdefault(name, []).append(trips(relay.port, TRIPS, PACE))
    for name, runs in found.items():
        p50, p99 = (median(percentile(run, share) for run in runs) for share in (0.5, 0.99))
        print(f"{name:26} p50 {p50:6.0f} µs  p99 {p99:7.0f} µs")


if __name__ == "__main__":
    main()
