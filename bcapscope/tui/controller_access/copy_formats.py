"""A call of the history as text for the clipboard."""

from __future__ import annotations

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.live.controller.history_record import HistoryRecord
from bcapscope.render.call_code import hex_text, python_program, shell_command


def copy_text(record: HistoryRecord, copy_format: str, target: ControllerTarget) -> str | None:
    """Return a call as ``hex``, ``python`` or ``line``; None if that format cannot express it."""
    if copy_format == "hex":
        return "\n".join(hex_text(seen.item.raw) for seen in record.packets) or None
    write = python_program if copy_format == "python" else shell_command
    return write(target, record.function_id, record.arguments, record.subject)
