"""The limits in docs/limits.md, and their values in the code."""

from __future__ import annotations

import re
from decimal import Decimal
from importlib import import_module
from pathlib import Path

PAGE = Path(__file__).parent.parent / "docs" / "limits.md"
ROW = re.compile(r"\| ([\d.]+)(?: (\w+))? \| .* \| `([\w.]+)\.(\w+)` \|")

NANOSECONDS = {"ms": Decimal(10**6), "s": Decimal(10**9)}
UNITS = {
    "": Decimal(1),
    "bytes": Decimal(1),
    "characters": Decimal(1),
    "KiB": Decimal(1 << 10),
    "MiB": Decimal(1 << 20),
    "ppm": Decimal("1e-6"),
    "s": Decimal(1),
}
SPANS_OF_TIME = {"proxy.script_queue.LONGEST_WAIT"}  # in ns, although their names do not say so


def documented_limits(room: str) -> list[tuple[str, Decimal]]:
    """Return the name and value of each limit of a subpackage. Times are in ns if the constant is."""
    found = []
    for number, unit, module, constant in ROW.findall(PAGE.read_text("utf-8")):
        name = f"{module}.{constant}"
        if module.startswith(f"{room}."):
            in_ns = constant.endswith("_NS") or name in SPANS_OF_TIME
            found.append((name, Decimal(number) * (NANOSECONDS if in_ns else UNITS)[unit]))
    return found


def value_in_code(name: str) -> float:
    module, _, constant = name.rpartition(".")
    value: float = getattr(import_module(f"bcapscope.{module}"), constant)
    return value
