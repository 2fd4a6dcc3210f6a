"""Settings of the screen: a small YAML file in the platform's folder for configuration."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import msgspec
import platformdirs

from bcapscope.errors import message_of
from bcapscope.faults.document import read_document
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file, and create missing parent folders. After an `OSError`, the old file is unchanged."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


MAX_RECENT = 20
"""Maximum number of recently used files, and of recently used hosts."""


class Settings(msgspec.Struct, omit_defaults=True):
    """Settings that the user chose, and recently used files and hosts, latest first."""

    theme: str = "dark"
    language: str = ""  # "en" or "ja"; if empty, the environment variable LANG decides
    captures: list[str] = []
    hosts: list[str] = []
    trajectories: list[str] = []


def default_settings_path() -> Path:
    return platformdirs.user_config_path("bcapscope", appauthor=False) / "screen.yaml"


def read_settings(path: Path) -> tuple[Settings, Message | None]:
    """Return the settings and None, or default settings and the reason why the file is unreadable."""
    try:
        return read_document(path.read_text(encoding="utf-8"), Settings), None
    except FileNotFoundError:
        return Settings(), None
    except OSError as error:
        return Settings(), os_reason(error)
    except ValueError as error:  # not UTF-8, or a `DocumentError`
        return Settings(), message_of(error)


def write_settings(settings: Settings, path: Path) -> None:
    write_atomically(path, msgspec.yaml.encode(settings))


def with_recent(item: str, recent: list[str]) -> list[str]:
    """Return `recent` with `item` in front, shortened to `MAX_RECENT` items."""
    if any("\ud800" <= letter <= "\udfff" for letter in item):  # YAML cannot store a lone surrogate
        return recent
    return [item, *(each for each in recent if each != item)][:MAX_RECENT]
