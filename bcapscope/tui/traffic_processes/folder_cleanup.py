"""The process that removes a folder once the screen that needs it has ended for any reason.

Run by its path, without site packages, as ``python -I -S folder_cleanup.py FOLDER``. It only waits for the
end of its standard input, which the operating system closes even if the screen is killed.
"""

import sys
from time import sleep

TRIES, PAUSE = 20, 0.25
"""Attempts to remove the folder, and seconds between them. Some systems cannot remove a file that another
process still has open; those processes end soon after."""


def remove_folder(folder: str) -> None:
    from os.path import exists  # noqa: PLC0415 - loaded only once the screen has ended
    from shutil import rmtree  # noqa: PLC0415

    for _ in range(TRIES):
        rmtree(folder, ignore_errors=True)
        if not exists(folder):
            return
        sleep(PAUSE)


if __name__ == "__main__":
    sys.stdin.buffer.read()
    remove_folder(sys.argv[1])
