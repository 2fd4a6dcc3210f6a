"""The process that saves packets and notes in a new file; the original file is never changed.

Run as ``python -m bcapscope.tui.traffic_processes.save_process``. The job arrives on standard input. Standard
output gets one sentence if something failed, and nothing otherwise.
"""

from __future__ import annotations

import io
import sys
from itertools import islice
from pathlib import Path

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.pcapng_writer import write_annotated
from bcapscope.errors import CaptureError
from bcapscope.render.escape import printable
from bcapscope.tui.traffic_processes.process_messages import SaveJob, receive_messages


def save_packets(job: SaveJob) -> str:
    """Write the new file; return why that failed or is incomplete, "" on success."""
    target = Path(job.target)
    try:
        file = target.open("xb")
    except OSError as error:
        return error.strerror or str(error)
    try:
        with file, open_capture(job.source) as capture:
            write_annotated(islice(capture, job.max_packets or None), job.notes, file)
    except CaptureError as error:
        return str(error)
    except OSError as error:
        target.unlink(missing_ok=True)
        return error.strerror or str(error)
    return ""


def main() -> None:
    """Run the job from standard input."""
    for wanted in receive_messages(io.FileIO(0, closefd=False), SaveJob):
        sys.stdout.write(printable(save_packets(wanted)))
        return


if __name__ == "__main__":
    main()
