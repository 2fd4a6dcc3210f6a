"""Settings: kept whole or not at all, and never fatal."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from bcapscope.tui.settings import MAX_RECENT, Settings, read_settings, with_recent, write_settings


def test_what_was_saved_is_loaded(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "screen.yaml"
    settings = Settings(theme="light", captures=["a.pcap", "b c.pcapng"], hosts=["10.0.0.1"])
    write_settings(settings, path)
    assert read_settings(path) == (settings, None)
    assert list(path.parent.iterdir()) == [path]


def test_there_are_none_yet(tmp_path: Path) -> None:
    assert read_settings(tmp_path / "none.yaml") == (Settings(), None)


@pytest.mark.parametrize("content", [b"theme: [", b"theme: 3", b"- a", b"\xff\x00", b"hosts: no"])
def test_a_broken_file_is_told_of(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "screen.yaml"
    path.write_bytes(content)
    settings, why = read_settings(path)
    assert settings == Settings()
    assert why
    assert "\n" not in str(why)


def test_a_file_from_a_later_version_is_read(tmp_path: Path) -> None:
    path = tmp_path / "screen.yaml"
    path.write_text("theme: safe\nnew: 1\n")
    assert read_settings(path)[0].theme == "safe"


def test_a_folder_is_told_of(tmp_path: Path) -> None:
    assert str(read_settings(tmp_path)[1]) == "is a directory"


def test_what_cannot_be_written_leaves_the_old_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "screen.yaml"
    write_settings(Settings(theme="light"), path)

    def refuse(source: object, target: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OSError, match="No space"):
        write_settings(Settings(theme="safe"), path)
    assert read_settings(path)[0].theme == "light"
    assert list(tmp_path.iterdir()) == [path]


def test_the_latest_comes_first_and_only_once() -> None:
    items: list[str] = []
    for number in (*range(MAX_RECENT + 5), 7):
        items = with_recent(str(number), items)
    assert items[:3] == ["7", str(MAX_RECENT + 4), str(MAX_RECENT + 3)]
    assert len(items) == MAX_RECENT
    assert len(set(items)) == MAX_RECENT


def test_names_of_files_may_be_anything(tmp_path: Path) -> None:
    items: list[str] = []
    for name in ("\x1b[31m\n[b]\u202e", "\udcff\udcfe.csv"):
        items = with_recent(name, items)
    settings = Settings(trajectories=items)
    write_settings(settings, tmp_path / "screen.yaml")
    assert read_settings(tmp_path / "screen.yaml") == (settings, None)
    assert items == ["\x1b[31m\n[b]\u202e"]
