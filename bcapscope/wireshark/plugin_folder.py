"""Wireshark's plugin folders, and the files for these folders: dissector, coloring rules and launcher."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from bcapscope.errors import FileWriteError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.protocol.tables.hresult import S_BUF_FULL, S_EXECUTING
from bcapscope.wireshark.dissector import dissector_text

IS_WINDOWS = sys.platform == "win32"
LAUNCHER_NAME = "bcapscope.bat" if IS_WINDOWS else "bcapscope"
DISSECTOR_NAME = "bcapscope.lua"
# Wireshark loads only .lua files from its plugin folder, so the user must import the coloring rules.
COLORING_RULES_NAME = "bcapscope.colorfilters"

_OWN_MARK = b"bcapscope"
_MARK_WITHIN = 400  # bytes


def default_plugin_folder() -> Path:
    """Return the folder that Wireshark lists under About > Folders as Personal Lua Plugins."""
    if IS_WINDOWS:
        return _windows_folder() / "plugins"
    return Path.home() / ".local" / "lib" / "wireshark" / "plugins"


def install(folder: Path, launcher_folders: Iterable[Path]) -> tuple[Path, Path, list[Path]]:
    """Write the dissector, the coloring rules and the launchers. Return the paths of these files.

    Raises FileWriteError if a file cannot be written, or belongs to another program.
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
    """Remove the files that `install` wrote, and return their paths.

    Raises FileWriteError if a file cannot be removed, or belongs to another program.
    """
    launchers = [each / LAUNCHER_NAME for each in launcher_folders]
    paths = [folder / DISSECTOR_NAME, folder / COLORING_RULES_NAME, *launchers]
    found = [path for path in paths if path.exists()]
    for path in found:
        _check_own(path)
    for path in found:
        try:
            path.unlink()
        except OSError as error:
            raise FileWriteError(path, os_reason(error)) from None
        if path in launchers:
            with suppress(OSError):  # the folder has other programs
                path.parent.rmdir()
    return found


def _check_own(path: Path) -> None:
    if not os.path.lexists(path):
        return
    try:
        with path.open("rb") as file:
            is_own = _OWN_MARK in file.read(_MARK_WITHIN)
    except OSError as error:
        raise FileWriteError(path, os_reason(error)) from None
    if not is_own:
        raise FileWriteError(path, Message("wireshark.foreign"))


_SHELL = """\
#!/bin/sh
# The capture interfaces of bcapscope, written by `bcapscope wireshark --install`.
# PYTHONSAFEPATH keeps Python from importing files of the folder in which Wireshark runs.
export PYTHONSAFEPATH=1
exec {python} -m bcapscope extcap "$@"
"""

_BATCH = """\
@echo off
rem The capture interfaces of bcapscope, written by `bcapscope wireshark --install`.
rem PYTHONSAFEPATH keeps Python from importing files of the folder in which Wireshark runs.
rem Without __PYVENV_LAUNCHER__, a second process would stand between this one and Python.
setlocal
chcp 65001 >nul
set "PYTHONSAFEPATH=1"
set "__PYVENV_LAUNCHER__={environment}"
"{python}" -m bcapscope extcap %*
"""


def launcher_text(executable: str = sys.executable, *, is_windows: bool = IS_WINDOWS) -> str:
    if not is_windows:
        return _SHELL.format(python=shlex.quote(executable))
    # `sys._base_executable` is what multiprocessing uses to start Python without the launcher of a venv.
    base = getattr(sys, "_base_executable", executable)
    text = _BATCH.format(environment=executable.replace("%", "%%"), python=base.replace("%", "%%"))
    return text.replace("\n", "\r\n")


def extcap_folders(folder: Path | None) -> tuple[Path, ...]:
    """Return where Wireshark looks for the launcher. If `folder` is None, return the user's folders.

    Wireshark 4.0 and older search the configuration folder; 4.2 and newer search ~/.local/lib instead. On
    Windows, all versions search the same folder.
    """
    if folder is not None:
        return (folder / "extcap",)
    if IS_WINDOWS:
        return (_windows_folder() / "extcap",)
    return _configuration_folder() / "extcap", Path.home() / ".local" / "lib" / "wireshark" / "extcap"


def _windows_folder() -> Path:
    return Path(os.environ.get("APPDATA") or Path.home() / "AppData" / "Roaming", "Wireshark")


def _configuration_folder() -> Path:
    """Return the folder of Wireshark's preferences.

    Wireshark would ignore an existing ~/.wireshark if bcapscope created ~/.config/wireshark.
    """
    if chosen := os.environ.get("WIRESHARK_CONFIG_DIR"):
        return Path(chosen)
    newer = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config", "wireshark")
    older = Path.home() / ".wireshark"
    return older if older.is_dir() and not newer.is_dir() else newer


_TEXT = (18, 39, 46)
_COLORING_RULES = (
    ("damaged", "bcap.problems", (120, 28, 34), (255, 240, 200)),
    (
        "failed",
        "bcap.hresult >= 0x80000000 || (bcap.hresult >= 0x1000 && bcap.hresult <= 0xffff)",
        (247, 186, 186),
        _TEXT,
    ),
    ("buffer full", f"bcap.hresult == 0x{S_BUF_FULL:08x}", (255, 222, 173), _TEXT),
    ("retry", "bcap.retry_of", (255, 243, 176), _TEXT),
    ("still executing", f"bcap.hresult == 0x{S_EXECUTING:x}", (226, 226, 226), _TEXT),
    ("reply", 'bcap.kind == "response"', (222, 240, 222), _TEXT),
    ("request", "bcap", (218, 232, 250), _TEXT),
)
"""Each rule has a name, a display filter, a background color and a text color. The first match wins."""


def coloring_rules_text() -> str:
    lines = [
        f"@b-CAP {name}@{display_filter}@{_color(background)}{_color(text)}"
        for name, display_filter, background, text in _COLORING_RULES
    ]
    return "\n".join(("# Coloring rules for b-CAP, written by bcapscope", *lines, ""))


def _color(levels: tuple[int, int, int]) -> str:
    return f"[{','.join(str(level * 257) for level in levels)}]"
