"""Write times as text. A time is an integer: nanoseconds since 1970-01-01 UTC."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from enum import StrEnum

_SECOND = 1_000_000_000


class TimeFormat(StrEnum):
    RELATIVE = "relative"  # seconds since the first frame
    DELTA = "delta"  # seconds since the previous line; in the first line, since the first frame
    UTC = "utc"  # date and time of day
    EPOCH = "epoch"  # seconds since 1970-01-01 UTC


def timestamp_writer(time_format: TimeFormat) -> Callable[[int], str]:
    """Return a function that formats times in ns. With `RELATIVE`, the first formatted time counts as 0."""
    if time_format is TimeFormat.UTC:
        return utc_text
    if time_format is TimeFormat.EPOCH:
        return epoch_text
    since_last = time_format is TimeFormat.DELTA
    reference: int | None = None

    def write(time: int) -> str:
        nonlocal reference
        elapsed = 0 if reference is None else time - reference
        if since_last or reference is None:
            reference = time
        if elapsed < 0:
            return f"{'-' + epoch_text(-elapsed)[:-3]:>12}"
        return "%5d.%06d" % divmod(elapsed // 1000, 1_000_000)

    return write


def epoch_text(time: int) -> str:
    """Return seconds since 1970-01-01 UTC with nine decimals."""
    sign, time = ("-", -time) if time < 0 else ("", time)
    return "%s%d.%09d" % (sign, *divmod(time, _SECOND))


def utc_text(time: int) -> str:
    """Return ISO 8601 text with nine decimals, or the same as `epoch_text` for a time after year 9999."""
    try:
        date = datetime.fromtimestamp(time // _SECOND, UTC)
    except (OverflowError, ValueError, OSError):
        return epoch_text(time)
    return f"{date:%Y-%m-%dT%H:%M:%S}.{time % _SECOND:09d}Z"
