"""The process that removes a folder after the screen that uses the folder has ended for any reason.

bcapscope runs this file by its path and without site packages, as ``python -I -S folder_cleanup.py FOLDER``.
The process only waits for the end of its standard input, which the operating system closes even if the screen
is killed.
"""

import sys
from time import sleep

TRIES, PAUSE = 20, 0.25
"""Maximum number of attempts to remove the folder, and seconds between the attempts.

Some systems cannot remove a file that another process still has open; the other processes end soon after.
"""


def remove_folder(folder: str) -> None:
    from os.path import exists  # noqa: PLC0415 - loaded only after the screen has ended
    from shutil import rmtree  # noqa: PLC0415

    for _ in range(TRIES):
        rmtree(folder, ignore_errors=True)
        if not exists(folder):
            return
        sleep(PAUSE)


if __name__ == "__main__":
    sys.stdin.buffer.read()
    remove_folder(sys.argv[1])
