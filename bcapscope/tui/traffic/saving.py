"""The process that saves packets with notes in a new file; the original is never touched.

Run as ``python -m bcapscope.tui.traffic.saving``; what to save comes through standard input, and how it went,
one sentence or nothing, goes to standard output.
"""

from __future__ import annotations

import io
import sys
from itertools import islice
from pathlib import Path

from bcapscope.capture.file import open_capture
from bcapscope.capture.packetfile import annotate
from bcapscope.errors import CaptureError
from bcapscope.render.escape import printable
from bcapscope.tui.traffic.report import Saving, receive


def save(wanted: Saving) -> str:
    """Write the new file; return why that was not possible or not all was there, "" where all went well."""
    target = Path(wanted.target)
    try:
        file = target.open("xb")
    except OSError as error:
        return error.strerror or str(error)
    try:
        with file, open_capture(wanted.source) as capture:
            annotate(islice(capture, wanted.most or None), wanted.notes, file)
    except CaptureError as error:
        return str(error)
    except OSError as error:
        target.unlink(missing_ok=True)
        return error.strerror or str(error)
    return ""


def main() -> None:
    """Save as standard input says."""
    for wanted in receive(io.FileIO(0, closefd=False), Saving):
        sys.stdout.write(printable(save(wanted)))
        return


if __name__ == "__main__":
    main()
