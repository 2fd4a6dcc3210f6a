"""The program in Wireshark's extcap folder that calls bcapscope, and the folders that Wireshark searches."""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path

IS_WINDOWS = sys.platform == "win32"
LAUNCHER_NAME = "bcapscope.bat" if IS_WINDOWS else "bcapscope"

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
    """Return the launcher, which calls bcapscope with the interpreter `executable`."""
    if not is_windows:
        return _SHELL.format(python=shlex.quote(executable))
    # `sys._base_executable` is what multiprocessing uses to start Python without the launcher of a venv.
    base = getattr(sys, "_base_executable", executable)
    text = _BATCH.format(environment=executable.replace("%", "%%"), python=base.replace("%", "%%"))
    return text.replace("\n", "\r\n")


def default_extcap_folders() -> tuple[Path, ...]:
    """Return the personal extcap folders of all versions of Wireshark.

    Wireshark 4.0 and older search the configuration folder; 4.2 and newer search ~/.local/lib instead. On
    Windows, all versions search the same folder.
    """
    if IS_WINDOWS:
        return (
            Path(os.environ.get("APPDATA") or Path.home() / "AppData" / "Roaming", "Wireshark", "extcap"),
        )
    return _configuration_folder() / "extcap", Path.home() / ".local" / "lib" / "wireshark" / "extcap"


def _configuration_folder() -> Path:
    """Return the folder in which Wireshark looks for its preferences.

    If ~/.wireshark exists, bcapscope does not create the newer folder. With the newer folder, Wireshark would
    ignore ~/.wireshark.
    """
    if chosen := os.environ.get("WIRESHARK_CONFIG_DIR"):
        return Path(chosen)
    newer = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config", "wireshark")
    older = Path.home() / ".wireshark"
    return older if older.is_dir() and not newer.is_dir() else newer
