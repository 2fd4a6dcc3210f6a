"""The process that removes the screen's temporary folder after the screen has ended, for whatever reason.

bcapscope runs this file by its path and without site packages, as ``python -I -S folder_cleanup.py FOLDER``.
The operating system closes the standard input of this process even if the screen is killed.
"""

import sys
from os.path import exists
from shutil import rmtree
from time import sleep

TRIES, PAUSE = 20, 0.25
"""Number of attempts to remove the folder, and seconds between two attempts. Other processes may still have a
file in it open.
"""

if __name__ == "__main__":
    sys.stdin.buffer.read()
    for _ in range(TRIES):
        rmtree(sys.argv[1], ignore_errors=True)
        if not exists(sys.argv[1]):
            break
        sleep(PAUSE)
