"""Folders for what is needed as long as the screen is there: journals, recordings nobody asked to keep."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from types import TracebackType

import platformdirs

from bcapscope.errors import BcapError
from bcapscope.tui.traffic_processes import folder_cleanup

_PREFIX = "traffic-"
_REMOVE_TIMEOUT = 10.0
"""Seconds that removing is waited for."""


class TemporaryFolderError(BcapError):
    """There can be no folder."""


class TemporaryFolder:
    """A folder that is gone when the screen is, even if that is killed; also a context manager.

    Its files have names, since several processes open them, the proxy's relay among them, and Windows removes
    no file that is open. So a process beside the screen waits for its end and then removes them.

    Attributes:
        path: where it is.
    """

    def __init__(self) -> None:
        """Make one where the platform keeps what may be lost.

        Raises:
            TemporaryFolderError: there is no room, or no right to.
        """
        root = cache_root()
        try:
            root.mkdir(parents=True, exist_ok=True)
            _remove_leftovers(root)
            self.path = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-", dir=root))
        except OSError as error:
            raise TemporaryFolderError(f"nothing can be kept in {root}: {error.strerror}") from error
        argv = [sys.executable, "-I", "-S", folder_cleanup.__file__, str(self.path)]
        self._cleanup_process = subprocess.Popen(
            argv,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def __enter__(self) -> TemporaryFolder:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Have it removed, and wait for that."""
        assert self._cleanup_process.stdin is not None
        with suppress(OSError):  # it was killed
            self._cleanup_process.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            self._cleanup_process.wait(_REMOVE_TIMEOUT)


def cache_root() -> Path:
    """Say where the platform keeps what may be lost."""
    return platformdirs.user_cache_path("bcapscope", appauthor=False)


def _remove_leftovers(root: Path) -> None:
    """Remove what a power cut left."""
    for left in root.glob(f"{_PREFIX}*"):
        if not _is_used(left):
            shutil.rmtree(left, ignore_errors=True)


def _is_used(folder: Path) -> bool:
    """Tell whether the process that a folder is named after still runs."""
    number = folder.name.removeprefix(_PREFIX).partition("-")[0]
    if not number.isdigit():
        return True
    if sys.platform == "win32":
        return True  # os.kill would end it; what is left over is small and lies in a cache
    try:
        os.kill(int(number), 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True
