"""Removes the folder that the argument names as soon as the screen ends.

This program runs in a process of its own. When the screen ends, the standard input of this process ends, too.
"""

import sys
from os.path import exists
from shutil import rmtree
from time import sleep

TRIES, PAUSE = 20, 0.25
"""Attempts to remove the folder, and seconds between two attempts. Windows cannot remove a folder that
contains an open file.
"""

if __name__ == "__main__":
    sys.stdin.buffer.read()
    for _ in range(TRIES):
        rmtree(sys.argv[1], ignore_errors=True)
        if not exists(sys.argv[1]):
            break
        sleep(PAUSE)
