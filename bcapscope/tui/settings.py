"""What the screen remembers: a small YAML file in the place that the platform has for it."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import msgspec
import platformdirs

from bcapscope.faults.document import read_document

MAX_RECENT = 20
"""Recent files and hosts that are remembered."""


class Settings(msgspec.Struct, omit_defaults=True):
    """What the user chose, and what was used lately.

    Attributes:
        theme: name of a theme.
        language: ``en`` or ``ja``; empty to go by LANG.
        captures: capture files opened lately, the latest first.
        hosts: controllers connected to lately, the latest first.
        trajectories: files played lately, the latest first.
    """

    theme: str = "dark"
    language: str = ""
    captures: list[str] = []
    hosts: list[str] = []
    trajectories: list[str] = []


def default_settings_path() -> Path:
    """Say where the settings lie on this platform."""
    return platformdirs.user_config_path("bcapscope", appauthor=False) / "screen.yaml"


def read_settings(path: Path) -> tuple[Settings, str]:
    """Read the settings.

    Returns:
        The settings, defaults where there are none, and why they could not be read, "" where they could.
    """
    try:
        return read_document(path.read_text(encoding="utf-8"), Settings), ""
    except FileNotFoundError:
        return Settings(), ""
    except OSError as error:
        return Settings(), error.strerror or str(error)
    except ValueError as error:  # no UTF-8, or a `DocumentError`
        return Settings(), " ".join(str(error).split())


def write_settings(settings: Settings, path: Path) -> None:
    """Write the settings whole or not at all.

    Raises:
        OSError: there is no room, or no right to.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(msgspec.yaml.encode(settings))
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def with_recent(item: str, recent: list[str]) -> list[str]:
    """Return the list with `item` at its head, and what was used longest ago dropped.

    A name of a file that is no text, with a lone surrogate in it, is not remembered: YAML does not hold it.
    """
    if any("\ud800" <= letter <= "\udfff" for letter in item):
        return recent
    return [item, *(each for each in recent if each != item)][:MAX_RECENT]
