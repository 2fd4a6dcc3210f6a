"""Find the captures in a folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from bcapscope.capture.capture_file import is_capture
from bcapscope.errors import CaptureError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason


def expand_folders(paths: Sequence[str], on_problem: Callable[[str, CaptureError], None]) -> Iterator[str]:
    """Yield the paths, with each folder replaced by the paths of the captures in it.

    A capture that is given both by its own path and by its folder is yielded once. `on_problem` receives each
    folder that has no capture or cannot be read.
    """
    named = {os.path.realpath(path) for path in paths}
    for path in paths:
        if not os.path.isdir(path):
            yield path
            continue
        try:
            found = _captures_in(path)
        except CaptureError as error:
            on_problem(path, error)
            continue
        yield from (each for each in found if os.path.realpath(each) not in named)


def _captures_in(folder: str) -> list[str]:
    """Return the paths of the captures in a folder, without subfolders and hidden files, sorted by name.

    Programs such as rsync give a file a hidden name while they copy it.

    Raises:
        CaptureError: The folder cannot be read, or has no capture.
    """
    try:
        names = sorted(os.listdir(folder))
    except OSError as error:
        raise CaptureError(Message("capture.cannot-open", reason=os_reason(error))) from error
    paths = [os.path.join(folder, name) for name in names if not name.startswith(".")]
    found = [path for path in paths if Path(path).is_file() and is_capture(path)]
    if not found:
        raise CaptureError(Message("capture.folder-without-captures"))
    return found
