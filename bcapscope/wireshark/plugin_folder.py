"""The folder from which Wireshark loads a user's Lua plugins, and bcapscope's files in this folder."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path

from bcapscope.errors import FileWriteError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.wireshark.coloring_rules import coloring_rules_text
from bcapscope.wireshark.dissector import dissector_text

DISSECTOR_NAME = "bcapscope.lua"
COLORING_RULES_NAME = "bcapscope.colorfilters"
"""Wireshark loads only .lua files from the folder, so the user must import the coloring rules."""

_OWN_MARK = b"bcapscope"
_MARK_WITHIN = 400  # bytes


def default_plugin_folder() -> Path:
    """Return the folder that Wireshark lists under About > Folders as Personal Lua Plugins."""
    if sys.platform == "win32":
        return Path(os.environ.get("APPDATA") or Path.home() / "AppData" / "Roaming", "Wireshark", "plugins")
    return Path.home() / ".local" / "lib" / "wireshark" / "plugins"


def install(folder: Path) -> tuple[Path, Path]:
    """Write the dissector and the coloring rules to `folder`, and return their paths.

    Raises:
        FileWriteError: A file cannot be written, or another program has a file with the same name.
    """
    files = {DISSECTOR_NAME: dissector_text(), COLORING_RULES_NAME: coloring_rules_text()}
    for name in files:
        _check_own(folder / name)
    for name, text in files.items():
        path = folder / name
        # Wireshark does not load a file with the temporary name
        temporary = path.with_name(f".{name}.{os.getpid()}.part")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            temporary.write_text(text, encoding="utf-8", newline="\n")
            temporary.replace(path)
        except OSError as error:
            with suppress(OSError):  # never created
                temporary.unlink()
            raise FileWriteError(path, os_reason(error)) from None
    return folder / DISSECTOR_NAME, folder / COLORING_RULES_NAME


def uninstall(folder: Path) -> list[Path]:
    """Remove the files that `install` wrote, and return the paths of the removed files.

    Raises:
        FileWriteError: A file cannot be removed, or another program has a file with the same name.
    """
    found = [path for name in (DISSECTOR_NAME, COLORING_RULES_NAME) if (path := folder / name).exists()]
    for path in found:
        _check_own(path)
    for path in found:
        try:
            path.unlink()
        except OSError as error:
            raise FileWriteError(path, os_reason(error)) from None
    return found


def _check_own(path: Path) -> None:
    """If a file exists at `path`, check that bcapscope wrote it."""
    if not os.path.lexists(path):
        return
    try:
        with path.open("rb") as file:
            is_own = _OWN_MARK in file.read(_MARK_WITHIN)
    except OSError as error:
        raise FileWriteError(path, os_reason(error)) from None
    if not is_own:
        raise FileWriteError(path, Message("wireshark.foreign"))
