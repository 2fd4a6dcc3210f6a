"""Temporary folders of the screen, for journals and for recordings that the user does not keep."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

import platformdirs

from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.tui.traffic_processes import folder_cleanup

_PREFIX = "traffic-"
_REMOVE_TIMEOUT = 10.0  # seconds


class TemporaryFolderError(BcapError):
    """The folder cannot be created."""


class TemporaryFolder:
    """A folder that is removed when the screen ends, even if the screen is killed.

    Temporary files without names are not enough, because several processes open these files. Windows cannot
    remove an open file, so a separate process waits until the screen has ended, and then removes the folder.
    """

    def __init__(self) -> None:
        """Create a folder in the platform's folder for caches, or raise `TemporaryFolderError`."""
        root = cache_root()
        try:
            root.mkdir(parents=True, exist_ok=True)
            _remove_leftovers(root)
            self.path = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-", dir=root))
        except OSError as error:
            message = Message("folder.not-created", root=str(root), reason=os_reason(error))
            raise TemporaryFolderError(message) from error
        self._cleanup_process = subprocess.Popen(
            [sys.executable, "-I", "-S", folder_cleanup.__file__, str(self.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def close(self) -> None:
        """Remove the folder. Wait at most `_REMOVE_TIMEOUT` seconds for the removal."""
        assert self._cleanup_process.stdin is not None
        with suppress(OSError):  # the process was killed
            self._cleanup_process.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            self._cleanup_process.wait(_REMOVE_TIMEOUT)


def cache_root() -> Path:
    return platformdirs.user_cache_path("bcapscope", appauthor=False)


def _remove_leftovers(root: Path) -> None:
    """Remove the folders that earlier screens left behind, for example after a power failure."""
    for left in root.glob(f"{_PREFIX}*"):
        if not _is_used(left):
            shutil.rmtree(left, ignore_errors=True)


def _is_used(folder: Path) -> bool:
    """Return whether the process whose id is in the folder's name may still run."""
    number = folder.name.removeprefix(_PREFIX).partition("-")[0]
    # on Windows, os.kill would end the process instead of testing whether the process runs
    if not number.isdigit() or sys.platform == "win32":
        return True
    try:
        os.kill(int(number), 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True
