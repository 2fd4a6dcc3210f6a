"""Exit codes, the same for all commands."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """How a command ended."""

    OK = 0
    """Everything asked for was done."""
    USAGE = 2
    """The command line makes no sense; nothing was read."""
    DAMAGED = 3
    """A capture is damaged or breaks off; all before the damage was given out."""
    UNREADABLE = 4
    """Nothing could be read: no such file, no capture, no right to listen."""
    NO_DATA = 5
    """The captures were read and hold nothing of what was asked for."""
    UNWRITABLE = 6
    """A file was not written, or is incomplete: it exists already, the disk is full, or access is denied."""
    NOT_INSTALLED = 7
    """A library that only this command needs is not installed."""
    REFUSED = 8
    """The controller refused a call."""
    UNANSWERED = 9
    """No way to the controller, or no answer in time."""
    UNARMED = 10
    """A call might move the robot, and nobody said `--arm`; it was not made."""
    UNFIT = 11
    """A trajectory is not fit to be played, as the pre-flight tells; nothing was moved."""
    INTERRUPTED = 130
    """Ctrl-C while there was something to do; shells name a program so that SIGINT ended."""
