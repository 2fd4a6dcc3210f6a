"""Meanings of numbers, bits and strings in arguments and results (`enumerations.tsv`)."""

from __future__ import annotations

from collections.abc import Mapping

from bcapscope.protocol.tables.table_rows import table_rows

_ROWS = list(table_rows("enumerations"))


def _texts(table: str) -> Mapping[str, str]:
    return {row["value"]: row["meaning"] for row in _ROWS if row["table"] == table}


def _numbers(table: str) -> Mapping[int, str]:
    return {int(value): meaning for value, meaning in _texts(table).items()}


INTERPOLATIONS = _numbers("interpolation")
POSE_TYPES = _numbers("pose type")
PASS_MOTIONS = _numbers("pass motion")
TASK_START_MODES = _numbers("start mode")
TASK_STOP_MODES = _numbers("stop mode")
TASK_STATES = _numbers("task state")
AUTO_MODES = _numbers("automatic mode")
SPEED_AXES = _numbers("axis")
SYS_STATE_BITS = _numbers("state bit")
OBJECT_OPTIONS = _texts("option")
MOVE_OPTIONS = _texts("move option")
PROVIDERS = _texts("provider")


def sys_state_texts(value: int) -> tuple[str, ...]:
    """Return the meanings of the bits set in a result of SysState. A reserved bit has a text like `bit 9`."""
    return tuple(SYS_STATE_BITS.get(bit, f"bit {bit}") for bit in range(32) if value >> bit & 1)


def result_meanings(function_id: int | None, command: str, value: int) -> tuple[str, ...]:
    """Return the meanings of a number that a command returned; () if the number has no special meaning."""
    key = function_id, command.casefold()
    if key == (_CONTROLLER_EXECUTE, "sysstate"):
        return sys_state_texts(value)
    text = _RESULT_MEANINGS.get(key, {}).get(value)
    return () if text is None else (text,)


def pass_motion_text(value: int) -> str:
    """Return the notation of a pass motion, such as `@E`."""
    return PASS_MOTIONS.get(value, f"@{value}")


def option_meanings(text: str, is_move: bool) -> dict[str, str]:
    """Return the meanings of the known keys in an option string such as `SPEED=50,NEXT`; ignore case."""
    known = MOVE_OPTIONS if is_move else OBJECT_OPTIONS
    keys = {part.partition("=")[0].strip().casefold() for part in text.split(",")}
    return {key: meaning for key, meaning in known.items() if key.casefold() in keys}


def provider_meaning(name: str) -> str | None:
    return _MEANING_BY_PROVIDER.get(name.casefold())


_CONTROLLER_EXECUTE, _TASK_EXECUTE = 17, 87
_RESULT_MEANINGS: Mapping[tuple[int | None, str], Mapping[int, str]] = {
    (_TASK_EXECUTE, "getstatus"): TASK_STATES,
    (_CONTROLLER_EXECUTE, "getautomode"): AUTO_MODES,
}
_MEANING_BY_PROVIDER = {name.casefold(): text for name, text in PROVIDERS.items()}
