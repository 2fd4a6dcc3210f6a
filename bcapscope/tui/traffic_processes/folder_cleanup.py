"""The process that removes a folder once the screen that needs it has ended, however that came about.

Run by its path, without site packages, as ``python -I -S folder_cleanup.py FOLDER``: it does nothing but wait
for the end of its standard input, which the system closes even where the screen was killed.
"""

import sys
from time import sleep

TRIES, PAUSE = 20, 0.25
"""A file that a process still has open cannot be removed on every system: the others end soon after."""


def remove_folder(folder: str) -> None:
    """Remove a folder and all in it."""
    from os.path import exists  # noqa: PLC0415 - all of this is loaded only when the screen has ended
    from shutil import rmtree  # noqa: PLC0415

    for _ in range(TRIES):
        rmtree(folder, ignore_errors=True)
        if not exists(folder):
            return
        sleep(PAUSE)


if __name__ == "__main__":
    sys.stdin.buffer.read()
    remove_folder(sys.argv[1])
