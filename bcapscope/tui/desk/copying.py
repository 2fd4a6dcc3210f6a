"""A call of the history as something to paste elsewhere."""

from __future__ import annotations

from bcapscope.client.target import Target
from bcapscope.render.code import call_line, hex_text, python_text
from bcapscope.traffic.opened import Opened
from bcapscope.tui.desk.record import Record


def copied(record: Record, what: str, target: Target, subject: Opened | None) -> str | None:
    """Write a call as ``hex``, ``python`` or ``line``; None where it cannot be written so.

    Args:
        record: the call.
        what: how.
        target: the controller, and how it is reached.
        subject: what its handle stands for; None where that is not known any more.
    """
    if what == "hex":
        return "\n".join(hex_text(seen.item.raw) for seen in record.packets) or None
    write = python_text if what == "python" else call_line
    return write(target, record.function_id, record.arguments, subject)
