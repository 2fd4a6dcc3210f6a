"""After the end of standard input, and so of the screen, removes the folder that the argument names."""

import sys
from os.path import exists
from shutil import rmtree
from time import sleep

TRIES, PAUSE = 20, 0.25
"""Attempts, and seconds between two attempts. Windows cannot remove a folder that contains an open file."""

if __name__ == "__main__":
    sys.stdin.buffer.read()
    for _ in range(TRIES):
        rmtree(sys.argv[1], ignore_errors=True)
        if not exists(sys.argv[1]):
            break
        sleep(PAUSE)
