"""Settings of the screen: a small YAML file in the platform's configuration folder."""

from __future__ import annotations

from pathlib import Path

import msgspec
import platformdirs

from bcapscope.errors import message_of
from bcapscope.faults.document import read_document
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.tui.atomic_file import write_atomically

MAX_RECENT = 20
"""Maximum number of recent files and of recent hosts."""


class Settings(msgspec.Struct, omit_defaults=True):
    """What the user chose, and recent files and hosts.

    Attributes:
        language: ``en`` or ``ja``; empty to use LANG.
        captures: Recently opened captures, latest first.
    """

    theme: str = "dark"
    language: str = ""
    captures: list[str] = []
    hosts: list[str] = []
    trajectories: list[str] = []


def default_settings_path() -> Path:
    return platformdirs.user_config_path("bcapscope", appauthor=False) / "screen.yaml"


def read_settings(path: Path) -> tuple[Settings, Message | None]:
    """Return the settings, or the defaults if there are none, and why they could not be read (else None)."""
    try:
        return read_document(path.read_text(encoding="utf-8"), Settings), None
    except FileNotFoundError:
        return Settings(), None
    except OSError as error:
        return Settings(), os_reason(error)
    except ValueError as error:  # not UTF-8, or a `DocumentError`
        return Settings(), message_of(error)


def write_settings(settings: Settings, path: Path) -> None:
    """Write the settings atomically; raises `OSError` if that fails."""
    write_atomically(path, msgspec.yaml.encode(settings))


def with_recent(item: str, recent: list[str]) -> list[str]:
    """Return the list with `item` first, cut to `MAX_RECENT`.

    A file name with a lone surrogate is not remembered, since YAML cannot store it.
    """
    if any("\ud800" <= letter <= "\udfff" for letter in item):
        return recent
    return [item, *(each for each in recent if each != item)][:MAX_RECENT]
