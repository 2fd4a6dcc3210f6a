"""Entry point of ``bcapscope`` and of ``python -m bcapscope``."""

from __future__ import annotations

import signal


def main() -> None:
    """Load the modules of the command line. Then run the command that the user typed."""
    python_ends = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if python_ends:  # while modules load, Ctrl-C ends the process without a traceback
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from bcapscope.cli import main as run  # noqa: PLC0415 - Ctrl-C during this import prints no traceback

    if python_ends:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


if __name__ == "__main__":
    main()
