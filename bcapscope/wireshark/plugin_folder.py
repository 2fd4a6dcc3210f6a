"""The folders from which Wireshark loads a user's plugins, and bcapscope's files in these folders."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from bcapscope.errors import FileWriteError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.wireshark.coloring_rules import coloring_rules_text
from bcapscope.wireshark.dissector import dissector_text
from bcapscope.wireshark.extcap_launcher import LAUNCHER_NAME, default_extcap_folders, launcher_text

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


def extcap_folders(folder: Path | None) -> tuple[Path, ...]:
    """Return the folders for the launcher: `extcap` in `folder`. If `folder` is None, return all folders in
    which Wireshark looks for launchers.
    """
    return default_extcap_folders() if folder is None else (folder / "extcap",)


def install(folder: Path, launcher_folders: Iterable[Path]) -> tuple[Path, Path, list[Path]]:
    """Write dissector, coloring rules and launchers; return the paths of these files.

    Raises:
        FileWriteError: A file cannot be written, or another program has a file with the same name.
    """
    dissector, coloring_rules = folder / DISSECTOR_NAME, folder / COLORING_RULES_NAME
    launchers = [each / LAUNCHER_NAME for each in launcher_folders]
    files = {dissector: dissector_text(), coloring_rules: coloring_rules_text()}
    files |= dict.fromkeys(launchers, launcher_text())
    for path in files:
        _check_own(path)
    for path, text in files.items():
        _write(path, text, 0o755 if path in launchers else 0o644)
    return dissector, coloring_rules, launchers


def _write(path: Path, text: str, mode: int) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")  # Wireshark loads no file with this name
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(text, encoding="utf-8", newline="")
        temporary.chmod(mode)
        temporary.replace(path)
    except OSError as error:
        with suppress(OSError):  # never created
            temporary.unlink()
        raise FileWriteError(path, os_reason(error)) from None


def uninstall(folder: Path, launcher_folders: Iterable[Path]) -> list[Path]:
    """Remove the files that `install` wrote, and return the paths of the removed files.

    Raises:
        FileWriteError: A file cannot be removed, or another program has a file with the same name.
    """
    paths = [folder / DISSECTOR_NAME, folder / COLORING_RULES_NAME]
    paths += [each / LAUNCHER_NAME for each in launcher_folders]
    found = [path for path in paths if path.exists()]
    for path in found:
        _check_own(path)
    for path in found:
        try:
            path.unlink()
        except OSError as error:
            raise FileWriteError(path, os_reason(error)) from None
        if path.name == LAUNCHER_NAME:
            with suppress(OSError):  # the folder has other programs
                path.parent.rmdir()
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
