"""Read and clear the active errors of a controller.

Read the errors before you clear them, because the controller forgets cleared errors.
"""

from __future__ import annotations

from bcapscope.client.object_opener import read_variable_once
from bcapscope.client.remote_objects import Controller
from bcapscope.errors import ControllerError
from bcapscope.protocol.codec.variant import Value
from bcapscope.protocol.tables.hresult import describe_hresult

MAX_ERRORS = 20
"""Maximum number of errors to read, the newest first."""


async def read_errors(controller: Controller) -> tuple[tuple[int, str], ...]:
    """Return the code and the text of each active error, newest first. Raises what `Session.call` raises."""
    found: list[tuple[int, str]] = []
    try:
        count = await controller.execute("GetCurErrorCount")
        for index in range(min(count, MAX_ERRORS) if isinstance(count, int) else 0):
            found.append(_error_info(await controller.execute("GetCurErrorInfo", index)))
    except ControllerError:
        code = await read_variable_once(controller, "@ERROR_CODE")
        text = await read_variable_once(controller, "@ERROR_DESCRIPTION")
        if code is not None and code.value:
            found.append(_error_info((code.value, text.value if text else None)))
    return tuple(found)


async def clear_errors(controller: Controller) -> None:
    """Raises what `Session.call` raises."""
    await controller.execute("ClearError")


def clean_text(value: Value) -> str:
    """Return a value as text; "" for EMPTY. Lone surrogates, which UTF-8 cannot encode, are replaced."""
    return "" if value is None else str(value).encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def _error_info(info: Value | tuple[Value, Value]) -> tuple[int, str]:
    number, text, *_ = (*info, None, None) if isinstance(info, tuple) else (None, info)
    code = number & 0xFFFFFFFF if isinstance(number, int) else 0
    return code, clean_text(text) or describe_hresult(code).text
