"""Recordings on a disk that becomes full: of a proxy, of a proxy with a ring, and of a simulator.

Run as ``python -m tests.security.fulldisk``. The small disk is a tmpfs, which only root can mount; the attack
is skipped for other users.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bcapscope.cli.common.exit_codes import ExitCode
from tests.cli.proxying import simulator
from tests.security.harness import Outcome, attacker, proxied, run_measured, under_attack


def can_mount() -> bool:
    """Return whether this user can make a small disk."""
    if not sys.platform.startswith("linux") or os.geteuid() != 0:
        return False
    with tempfile.TemporaryDirectory() as folder:
        try:
            with small_disk(Path(folder), 100):
                return True
        except subprocess.CalledProcessError:  # a container without the right to mount
            return False


@contextmanager
def small_disk(folder: Path, kilobytes: int) -> Iterator[Path]:
    """Mount a disk of so many kB for the length of a block."""
    options = f"size={kilobytes}k"
    command = ["mount", "-t", "tmpfs", "-o", options, "bcapscope-test", str(folder)]
    subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def withstand(kilobytes: int, seconds: float) -> list[Outcome]:
    """Fill small disks; return the figures."""
    outcomes = []
    for name, ring, code in (
        ("proxy --record", (), ExitCode.UNWRITABLE),
        ("proxy --record --ring", ("--ring", f"20x{kilobytes}kB"), ExitCode.OK),
        ("sim --record", (), ExitCode.UNWRITABLE),
    ):
        with tempfile.TemporaryDirectory() as folder, small_disk(Path(folder), kilobytes) as disk:
            words = ("--record", str(disk / "r.pcapng"), *ring)
            server = simulator(*words) if name.startswith("sim") else proxied("-q", *words)
            outcomes.append(
                under_attack(
                    f"{name} to a disk of {kilobytes} kB",
                    server,
                    lambda port: attacker("tests.security.sources", port, 1000),
                    seconds=seconds,
                    code=code,
                )
            )
            _check_files(disk)
    return outcomes


def _check_files(disk: Path) -> None:
    """Check that the newest recording has frames and ends with a whole packet."""
    files = sorted(disk.iterdir())
    assert files
    for path in files[-1:]:
        ended = run_measured(["decode", path])
        assert ended.code == ExitCode.OK, ended.err
        assert ended.out


def main() -> None:
    """Run the attack in its full size."""
    if not can_mount():
        print("skipped: only root can mount a small disk")
        return
    withstand(500, 5.0)


if __name__ == "__main__":
    main()
