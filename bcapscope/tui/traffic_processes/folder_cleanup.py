"""The process that removes a folder after the screen that uses the folder has ended for any reason.

bcapscope runs this file by its path and without site packages, as ``python -I -S folder_cleanup.py FOLDER``.
The operating system closes the standard input of this process even if the screen is killed.
"""

import sys
from os.path import exists
from shutil import rmtree
from time import sleep

TRIES, PAUSE = 20, 0.25
"""Attempts to remove the folder, and seconds between them: other processes may still have a file open."""

if __name__ == "__main__":
    sys.stdin.buffer.read()
    for _ in range(TRIES):
        rmtree(sys.argv[1], ignore_errors=True)
        if not exists(sys.argv[1]):
            break
        sleep(PAUSE)
