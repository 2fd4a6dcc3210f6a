"""A call of the history as something to paste elsewhere."""

from __future__ import annotations

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.render.call_code import hex_text, python_program, shell_command
from bcapscope.traffic.handle_table import ObjectHandle
from bcapscope.tui.controller_access.history_record import HistoryRecord


def copy_text(
    record: HistoryRecord, copy_format: str, target: ControllerTarget, subject: ObjectHandle | None
) -> str | None:
    """Write a call as ``hex``, ``python`` or ``line``; None where it cannot be written so.

    Args:
        record: the call.
        copy_format: how.
        target: the controller, and how it is reached.
        subject: what its handle stands for; None where that is not known any more.
    """
    if copy_format == "hex":
        return "\n".join(hex_text(seen.item.raw) for seen in record.packets) or None
    write = python_program if copy_format == "python" else shell_command
    return write(target, record.function_id, record.arguments, subject)
