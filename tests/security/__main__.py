"""Run every attack, one after the other; exit with 1 if one of them succeeded."""

from __future__ import annotations

import sys
import traceback
from importlib import import_module
from pathlib import Path

_NOT_ATTACKS = {"__init__", "__main__", "harness"}


def main() -> int:
    """Run the ``main`` of each module in this folder."""
    folder = Path(__file__).parent
    names = sorted(
        path.stem
        for path in folder.glob("*.py")
        if path.stem not in _NOT_ATTACKS and not path.stem.startswith("test_")
    )
    failed = []
    for name in names:
        print(f"== {name}", flush=True)
        try:
            import_module(f"tests.security.{name}").main()
        except (Exception, SystemExit):  # one attack that succeeds must not hide the next
            traceback.print_exc()
            failed.append(name)
    print(
        f"{len(names) - len(failed)} of {len(names)} attacks repelled; failed: {', '.join(failed) or 'none'}"
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
