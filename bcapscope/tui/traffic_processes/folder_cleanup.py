"""Removes the folder that is its argument at the end of standard input, so after the end of the screen."""

import sys
from os.path import exists
from shutil import rmtree
from time import sleep

TRIES, PAUSE = 20, 0.25
"""Attempts, and seconds between two. Windows cannot remove a folder while one of its files is open."""

if __name__ == "__main__":
    sys.stdin.buffer.read()
    for _ in range(TRIES):
        rmtree(sys.argv[1], ignore_errors=True)
        if not exists(sys.argv[1]):
            break
        sleep(PAUSE)
