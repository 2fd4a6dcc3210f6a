"""Saved requests: one small YAML file per request, such as:

    function: Robot_Execute
    arguments:
    - slvChangeMode
    - i4:2
    note: slave mode with joints

The file contains no handle: when the user sends the request, bcapscope adds the selected object's handle.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import msgspec
import platformdirs

from bcapscope.errors import BcapError, message_of
from bcapscope.faults.document import read_document
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.protocol.codec.variant import Variant
from bcapscope.protocol.codec.variant_notation import parse_variant_as
from bcapscope.protocol.tables.function_table import FUNCTIONS, Function, Param, function_by_name
from bcapscope.render.call_code import argument_text
from bcapscope.tui.reader_language import full_error_text
from bcapscope.tui.settings import write_atomically

MAX_FILE_SIZE = 100_000
"""Maximum size of a file in bytes."""

_UNSAFE = re.compile(r"[^\w .-]+")
_SUFFIX = ".yaml"


class SavedRequestError(BcapError):
    """A file contains no request, or cannot be read or written."""


class _RequestFile(msgspec.Struct, forbid_unknown_fields=True, omit_defaults=True):
    function: str
    arguments: list[str | int | float | bool] = []
    note: str = ""


class SavedRequest(NamedTuple):
    name: str  # name of the file, without the extension
    function: Function
    values: tuple[Variant, ...]  # arguments without the handle
    note: str = ""


def default_requests_folder() -> Path:
    return platformdirs.user_data_path("bcapscope", appauthor=False) / "requests"


def list_requests(folder: Path) -> list[tuple[str, SavedRequest | str]]:
    """Return each file's name with its request, or with the reason why the file is unreadable."""
    found: list[tuple[str, SavedRequest | str]] = []
    with suppress(OSError):
        for path in sorted(folder.glob(f"*{_SUFFIX}")):
            try:
                found.append((path.stem, load_request(path)))
            except SavedRequestError as error:
                found.append((path.stem, full_error_text(error)))
    return found


def load_request(path: Path) -> SavedRequest:
    """Read one file; raises `SavedRequestError`, whose text says what is wrong with the file."""
    try:
        with path.open("rb") as file:
            content = file.read(MAX_FILE_SIZE + 1)
        if len(content) > MAX_FILE_SIZE:
            raise SavedRequestError(Message("controller.saved.large", name=path.name, most=MAX_FILE_SIZE))
        found = read_document(content.decode("utf-8"), _RequestFile)
    except OSError as error:
        raise _problem(path.name, os_reason(error)) from None
    except ValueError as error:  # not UTF-8, or a `DocumentError`
        raise _problem(path.name, message_of(error)) from None
    function = function_by_name(found.function)
    if function is None:
        name = repr(found.function)
        raise SavedRequestError(Message("controller.saved.function", name=path.name, function=name))
    params = function.params[1:] if function.takes_handle else function.params
    if len(params) != len(found.arguments):
        names = ", ".join(param.name for param in params) or Message("controller.saved.none")
        count = len(found.arguments)
        raise SavedRequestError(Message("controller.saved.count", name=path.name, count=count, names=names))
    values = tuple(_parse_argument(path, *each) for each in zip(params, found.arguments, strict=True))
    return SavedRequest(path.stem, function, values, found.note)


def _problem(name: str, reason: Message | str) -> SavedRequestError:
    return SavedRequestError(Message("controller.saved.problem", name=name, reason=reason))


def _parse_argument(path: Path, param: Param, given: str | int | float | bool) -> Variant:
    text = str(given).lower() if isinstance(given, bool) else str(given)
    try:
        return parse_variant_as(text, (param.type,))
    except ValueError as error:
        raise _problem(f"{path.name}: {param.name}", message_of(error)) from None


def save_request(
    folder: Path, name: str, function_id: int, arguments: Sequence[Variant], note: str = ""
) -> Path:
    """Write a saved request atomically, and return its file. `arguments` include the handle.

    Raises:
        SavedRequestError: An argument has no text notation, the name is empty, or the file cannot be written.
    """
    function = FUNCTIONS.get(function_id)
    if function is None or len(function.params) != len(arguments):
        raise SavedRequestError(Message("controller.saved.unknown"))
    skipped = 1 if function.takes_handle else 0
    pairs = list(zip(function.params, arguments, strict=True))[skipped:]
    texts = [argument_text(param, argument) for param, argument in pairs]
    if None in texts:
        raise SavedRequestError(Message("controller.saved.nested"))
    stem = _UNSAFE.sub("_", name).strip(" .")[:80]
    if not stem:
        raise SavedRequestError(Message("controller.saved.name"))
    try:
        content = msgspec.yaml.encode(_RequestFile(function.name, [text or "" for text in texts], note))
    except UnicodeEncodeError:  # a lone surrogate
        raise SavedRequestError(Message("controller.saved.half")) from None
    path = folder / f"{stem}{_SUFFIX}"
    try:
        write_atomically(path, content)
    except OSError as error:
        raise _problem(str(folder), os_reason(error)) from None
    return path
