"""The save process, which writes packets and notes to a new file, and never changes the original file. The
job arrives on standard input. Standard output receives one sentence if saving failed, and nothing otherwise.
"""

from __future__ import annotations

import io
import sys
from itertools import islice
from pathlib import Path

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.pcapng_writer import write_annotated
from bcapscope.errors import CaptureError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.tui.traffic_processes.process_messages import SaveJob, problem_text, receive_messages


def save_packets(job: SaveJob) -> Message | None:
    """Write the new file. Return None, or why writing failed or why the file is incomplete."""
    target = Path(job.target)
    try:
        file = target.open("xb")
    except OSError as error:
        return os_reason(error)
    try:
        with file, open_capture(job.source) as capture:
            write_annotated(islice(capture, job.max_packets or None), job.notes, file)
    except CaptureError as error:
        return error.message
    except OSError as error:
        target.unlink(missing_ok=True)
        return os_reason(error)
    return None


def main() -> None:
    for job in receive_messages(io.FileIO(0, closefd=False), SaveJob):
        sys.stdout.write(problem_text(save_packets(job), job))
        return


if __name__ == "__main__":
    main()
