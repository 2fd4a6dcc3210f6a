"""The process that removes the screen's temporary folder after the screen has ended or was killed.

bcapscope runs this file by its path, without site packages: ``python -I -S folder_cleanup.py FOLDER``. The
end of standard input shows that the screen has ended or was killed.
"""

import sys
from os.path import exists
from shutil import rmtree
from time import sleep

TRIES, PAUSE = 20, 0.25
"""Number of attempts to remove the folder, and seconds between two attempts. Windows cannot remove a folder
while another process has a file in the folder open.
"""

if __name__ == "__main__":
    sys.stdin.buffer.read()
    for _ in range(TRIES):
        rmtree(sys.argv[1], ignore_errors=True)
        if not exists(sys.argv[1]):
            break
        sleep(PAUSE)
