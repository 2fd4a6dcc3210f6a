"""``bcapscope wireshark``."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

from bcapscope.traffic.filter.field_table import RecordKind, fields_of
from bcapscope.wireshark.plugin_folder import default_plugin_folder
from tests.cli.run import CAPTURES, run, run_here
from tests.wireshark.tshark import needs_tshark


def test_install_writes_what_uninstall_removes(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "plugins"
    done = run_here("wireshark", "--install", "--folder", folder)
    assert done.code == 0
    assert {path.name for path in folder.iterdir()} == {"bcapscope.lua", "bcapscope.colorfilters"}
    assert all(str(path) in done.out for path in folder.iterdir())
    assert run_here("wireshark", "--install", "--folder", folder).code == 0
    assert run_here("wireshark", "--uninstall", "--folder", folder).code == 0
    assert list(folder.iterdir()) == []
    again = run_here("wireshark", "--uninstall", "--folder", folder)
    assert (again.code, again.out) == (0, f"{folder}: nothing to remove\n")


def test_print_prints_what_install_writes(tmp_path: Path) -> None:
    run_here("wireshark", "--install", "--folder", tmp_path)
    assert (tmp_path / "bcapscope.lua").read_text(encoding="utf-8") == run_here("wireshark", "--print").out


@pytest.mark.parametrize("option", ["--install", "--uninstall"])
def test_files_of_others_stay(option: str, tmp_path: Path) -> None:
    path = tmp_path / "bcapscope.lua"
    path.write_text("print('mine')")
    done = run("wireshark", option, "--folder", tmp_path)
    assert done.code == 6
    assert "another program wrote this file" in done.err
    assert path.read_text() == "print('mine')"
    assert list(tmp_path.iterdir()) == [path]


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
