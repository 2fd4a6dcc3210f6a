"""What starting the program really imports: the heavy libraries are for those who need them."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

import bcapscope

HEAVY = {"numpy", "orjson", "rich", "scapy", "textual"}
SAMPLE = Path(__file__).parent.parent / "captures" / "exchanges.pcap"
SCAPY_USERS = {"bcapscope.scapy_layer", "bcapscope.capture.sniffer"}

# Imports every module named on the command line in turn and tells which was the first to bring scapy along.
_FIRST_WITH_SCAPY = """
import importlib, sys
for name in sys.argv[1:]:
    importlib.import_module(name)
    if "scapy" in sys.modules:
        sys.exit(f"{name} imports scapy")
"""

# Presses Ctrl-C where click is looked for.
_CTRL_C_WHILE_LOADED = """
import os, signal, sys
class Finder:
    def find_spec(self, name, *_):
        if name == "click":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
from bcapscope.__main__ import main
main()
"""


def _modules() -> set[str]:
    """Return the full names of all modules of the package."""
    (root,) = bcapscope.__path__
    paths = (path.relative_to(Path(root).parent) for path in Path(root).rglob("*.py"))
    return {".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in paths}


def _imported_by(*args: str) -> set[str]:
    """Return the top-level names of all modules imported while ``python -m bcapscope`` ran with `args`."""
    argv = [sys.executable, "-X", "importtime", "-m", "bcapscope", *args]
    done = subprocess.run(argv, capture_output=True, text=True, check=True)
    lines = [line for line in done.stderr.splitlines() if line.startswith("import time:")]
    return {line.rpartition("|")[2].strip().partition(".")[0] for line in lines}


@pytest.mark.lifecycle
def test_help_imports_nothing_heavy() -> None:
    imported = _imported_by("--help")
    assert "bcapscope" in imported
    assert not imported & HEAVY


def test_version_imports_nothing_heavy() -> None:
    assert not _imported_by("--version") & HEAVY


@pytest.mark.parametrize("command", ["decode", "calls"])
def test_reading_a_capture_does_not_import_numpy(command: str) -> None:
    imported = _imported_by(command, str(SAMPLE))
    assert "click" in imported
    assert not imported & {"numpy", "rich", "scapy", "textual"}


@pytest.mark.parametrize("question", [["--extcap-interfaces"], ["--extcap-config"]])
def test_wireshark_does_not_wait_for_heavy_libraries(question: list[str]) -> None:
    imported = _imported_by("extcap", "--extcap-interface", "bcapscope-sim", *question)
    assert "click" in imported
    assert not imported & (HEAVY | {"asyncio", "multiprocessing", "msgspec", "yaml"})


def test_calls_does_not_import_what_takes_frames_apart() -> None:
    program = (
        "import bcapscope.cli.calls, sys; print(*(name for name in sys.modules if 'dissection' in name))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "\n"


@pytest.mark.lifecycle
def test_ctrl_c_while_it_is_loaded_ends_it_without_a_word() -> None:
    argv = [sys.executable, "-c", _CTRL_C_WHILE_LOADED]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full on this system")
def test_help_that_finds_no_room_is_told_in_one_sentence() -> None:
    argv = [sys.executable, "-m", "bcapscope", "--help"]
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(argv, stdout=full, stderr=subprocess.PIPE, check=False)
    assert (done.returncode, done.stderr) == (
        6,
        b"Error: cannot write to standard output: no space left on device\n",
    )


def test_scapy_is_imported_only_by_the_modules_that_need_it() -> None:
    modules = _modules()
    assert "bcapscope.capture.byte_source" in modules
    argv = [sys.executable, "-c", _FIRST_WITH_SCAPY, *sorted(modules - SCAPY_USERS)]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
