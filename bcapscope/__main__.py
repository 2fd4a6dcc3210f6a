"""Start the command line: as ``bcapscope``, and with ``python -m bcapscope``."""

from __future__ import annotations

import signal


def main() -> None:
    """Load the command line and run it."""
    python_ends = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if python_ends:  # Ctrl-C while it is loaded ends it without a word, not with a traceback
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from bcapscope.cli import main as run  # noqa: PLC0415 - while Ctrl-C has no traceback

    if python_ends:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


if __name__ == "__main__":
    main()
