"""``bcapscope wireshark``."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

from bcapscope.traffic.filter.field_table import RecordKind, fields_of
from bcapscope.wireshark.plugin_folder import (
    LAUNCHER_NAME,
    default_plugin_folder,
    extcap_folders,
    launcher_text,
)
from tests.cli.run import CAPTURES, run, run_here
from tests.wireshark.tshark import needs_tshark


def test_install_writes_what_uninstall_removes(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "plugins"
    done = run_here("wireshark", "--install", "--folder", folder)
    assert done.code == 0
    paths = [path for path in folder.rglob("*") if path.is_file()]
    assert {path.name for path in paths} == {"bcapscope.lua", "bcapscope.colorfilters", LAUNCHER_NAME}
    assert all(str(path) in done.out for path in paths)
    assert run_here("wireshark", "--install", "--folder", folder).code == 0
    assert run_here("wireshark", "--uninstall", "--folder", folder).code == 0
    assert list(folder.iterdir()) == []
    again = run_here("wireshark", "--uninstall", "--folder", folder)
    assert (again.code, again.out) == (0, f"{folder}: nothing to remove\n")


def test_print_prints_what_install_writes(tmp_path: Path) -> None:
    run_here("wireshark", "--install", "--folder", tmp_path)
    assert (tmp_path / "bcapscope.lua").read_text(encoding="utf-8") == run_here("wireshark", "--print").out


@pytest.mark.parametrize("option", ["--install", "--uninstall"])
@pytest.mark.parametrize("name", ["bcapscope.lua", f"extcap/{LAUNCHER_NAME}"])
def test_files_of_others_stay(name: str, option: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("print('mine')")
    done = run("wireshark", option, "--folder", tmp_path)
    assert done.code == 6
    assert "another program wrote this file" in done.err
    assert path.read_text() == "print('mine')"
    assert [each for each in tmp_path.rglob("*") if each.is_file()] == [path]


def test_uninstall_keeps_other_capture_programs(tmp_path: Path) -> None:
    run_here("wireshark", "--install", "--folder", tmp_path)
    other = tmp_path / "extcap" / "other"
    other.touch()
    assert run_here("wireshark", "--uninstall", "--folder", tmp_path).code == 0
    assert list(other.parent.iterdir()) == [other]


@pytest.mark.skipif(os.name != "posix", reason="the launcher is a shell script")
def test_the_launcher_starts_bcapscope_in_any_folder(tmp_path: Path) -> None:
    run_here("wireshark", "--install", "--folder", tmp_path)
    hostile = tmp_path / "bcapscope.py"
    hostile.write_text("raise SystemExit('wrong program')")
    argv = [str(tmp_path / "extcap" / LAUNCHER_NAME), "--extcap-interfaces"]
    done = subprocess.run(argv, cwd=tmp_path, capture_output=True, check=True, text=True)
    assert "bcapscope-sim" in done.stdout


def test_a_launcher_quotes_the_path_of_python() -> None:
    assert "exec '/my python/it'\"'\"'s' -m bcapscope" in launcher_text("/my python/it's", is_windows=False)
    batch = launcher_text(r"C:\100% Python\python.exe", is_windows=True)
    assert r"C:\100%% Python\python.exe" in batch
    assert batch.count("\r\n") == batch.count("\n")


@pytest.mark.skipif(os.name != "posix", reason="Windows has one folder")
def test_launchers_are_where_old_and_new_versions_of_wireshark_look(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in ("WIRESHARK_CONFIG_DIR", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    newer = tmp_path / ".local" / "lib" / "wireshark" / "extcap"
    assert extcap_folders(None) == (tmp_path / ".config" / "wireshark" / "extcap", newer)
    (tmp_path / ".wireshark").mkdir()
    assert extcap_folders(None) == (tmp_path / ".wireshark" / "extcap", newer)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "c"))
    (tmp_path / "c" / "wireshark").mkdir(parents=True)
    assert extcap_folders(None) == (tmp_path / "c" / "wireshark" / "extcap", newer)
    monkeypatch.setenv("WIRESHARK_CONFIG_DIR", str(tmp_path / "d"))
    assert extcap_folders(None) == (tmp_path / "d" / "extcap", newer)


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    done = run("wireshark", "--install", "--folder", tmp_path / "file" / "plugins")
    assert done.code == 6
    assert "not a directory" in done.err


@pytest.mark.parametrize("words", [(), ("--install", "--print"), ("--print", "--folder", "a")])
def test_contradicting_options_are_an_error(words: tuple[str, ...]) -> None:
    assert run_here("wireshark", *words).code == 2


@needs_tshark
def test_tshark_loads_the_installed_dissector(tmp_path: Path) -> None:
    assert run("wireshark", "--install", HOME=str(tmp_path)).code == 0
    argv = ["tshark", "-r", str(CAPTURES / "exchanges.pcap")]
    done = subprocess.run(argv, capture_output=True, check=True, env={**os.environ, "HOME": str(tmp_path)})
    assert b"Request 5 Robot_Execute slvChangeMode" in done.stdout


@needs_tshark
def test_fields_have_the_names_of_the_filter(tmp_path: Path) -> None:
    assert run("wireshark", "--install", HOME=str(tmp_path)).code == 0
    argv = ["tshark", "-G", "fields"]
    done = subprocess.run(argv, capture_output=True, check=True, env={**os.environ, "HOME": str(tmp_path)})
    names = re.findall(r"(?m)^F\t[^\t]*\tbcap\.([^\t]*)", done.stdout.decode())
    # Wireshark has these fields itself: frame.number, frame.time, ip.src, udp.port and so on.
    elsewhere = {"frame", "packet", "time", "t", "src", "dst", "client", "server", "transport"}
    assert fields_of(RecordKind.FRAME).keys() - elsewhere <= set(names)


def test_the_default_folder_is_below_the_home_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert tmp_path in default_plugin_folder().parents
