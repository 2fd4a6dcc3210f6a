"""Fuzz one target: ``python tests/fuzz/fuzz.py TARGET [libFuzzer arguments]``.

With atheris installed it is guided by coverage and takes libFuzzer's arguments (``-max_total_time=600``,
``-runs=0 CRASH_FILE``, a corpus directory). Without it a plain loop mutates the seeds, and of the
arguments only ``-max_total_time`` and ``-seed`` count.
"""

from __future__ import annotations

import importlib
import random
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[2]
MAX_LENGTH = {
    "frame": 4096,
    "stream": 4096,
    "capture": 8192,
    "render": 1024,
    "text": 4096,
    "simulator": 4096,
    "trajectory": 4096,
    "rules": 4096,
}
ELSEWHERE = {
    "render": "tests.fuzz.rendering",
    "simulator": "tests.fuzz.simulating",
    "trajectory": "tests.fuzz.playing",
    "rules": "tests.fuzz.ruling",
}
"""Modules of the targets that are not in `tests.fuzz.targets`."""


def main(argv: list[str]) -> int:
    """Run the target named first; return an exit code, unless libFuzzer ends the process itself."""
    if len(argv) < 2 or argv[1] not in MAX_LENGTH:
        print(f"usage: {argv[0]} {{{','.join(MAX_LENGTH)}}} [libFuzzer arguments]", file=sys.stderr)
        return 2
    sys.path.insert(0, str(ROOT))
    name, options = argv[1], argv[2:]
    try:
        import atheris  # noqa: PLC0415 - instruments what is imported after it
    except ImportError:
        print("atheris is not installed: random mutations only", file=sys.stderr)
        return _mutate(name, options)
    with atheris.instrument_imports(include=["bcapscope"]):
        target = target_of(name)
    with tempfile.TemporaryDirectory(prefix=f"fuzz-{name}-") as corpus:
        for number, seed in enumerate(_seeds(name)):
            Path(corpus, f"seed-{number:03}").write_bytes(seed)
        corpora = [] if any(not option.startswith("-") for option in options) else [corpus]
        atheris.Setup([argv[0], f"-max_len={MAX_LENGTH[name]}", *options, *corpora], target)
        atheris.Fuzz()
    return 0


def target_of(name: str) -> Callable[[bytes], None]:
    """Import a target, and with it what it tries."""
    module = importlib.import_module(ELSEWHERE.get(name, "tests.fuzz.targets"))
    target: Callable[[bytes], None] = getattr(module, name)
    return target


def _seeds(name: str) -> list[bytes]:
    seeds: list[bytes] = importlib.import_module("tests.fuzz.seeds").SEEDS[name]()
    return seeds


def _mutate(name: str, options: list[str]) -> int:
    settings = dict(option.lstrip("-").split("=", 1) for option in options if "=" in option)
    chance = random.Random(int(settings.get("seed", "0")))
    stop = time.monotonic() + float(settings.get("max_total_time", "60"))
    target, seeds = target_of(name), _seeds(name)
    runs = 0
    while time.monotonic() < stop:
        data = mutated(chance.choice(seeds), chance)[: MAX_LENGTH[name]]
        try:
            target(data)
        except Exception:
            Path(f"crash-{name}").write_bytes(data)
            print(f"run {runs}: kept as crash-{name}", file=sys.stderr)
            raise
        runs += 1
    print(f"{runs} runs, nothing found", file=sys.stderr)
    return 0


def mutated(data: bytes, chance: random.Random) -> bytes:
    """Change a few bytes of `data`, cut it, or repeat a part of it."""
    changed = bytearray(data)
    for _ in range(chance.randint(1, 6)):
        spot = chance.randrange(len(changed) + 1)
        stretch = changed[spot : spot + chance.randint(1, 8)]
        match chance.randrange(4):
            case 0:
                changed[spot : spot + 1] = chance.choice(
                    (b"\x00", b"\x01", b"\x04", b"\xff", chance.randbytes(1))
                )
            case 1:
                del changed[spot : spot + len(stretch)]
            case 2:
                changed[spot:spot] = stretch * chance.randint(1, 4)
            case _:
                changed[spot:spot] = chance.randbytes(chance.randint(1, 8))
    return bytes(changed)


if __name__ == "__main__":
    sys.exit(main(sys.argv))
