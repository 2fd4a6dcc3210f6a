"""Licences: the documented table fits the dependencies, and scapy is loaded beside none that forbids it."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import click
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from bcapscope.cli import cli
from bcapscope.errors import CaptureError
from tests.capture.packets import request
from tests.proxy.relaying import eventually

PAGE = Path(__file__).parent.parent / "docs" / "licences.md"
EXTRAS = ("", "arrow", "pandas", "report", "serve", "test", "docs")
SYSTEMS = (
    {"sys_platform": "linux", "platform_system": "Linux", "os_name": "posix"},
    {"sys_platform": "win32", "platform_system": "Windows", "os_name": "nt"},
)

SPDX = {
    "apache 2": "Apache-2.0",
    "apache 2.0": "Apache-2.0",
    "apache software license": "Apache-2.0",
    "bsd 2-clause license": "BSD-2-Clause",
    "bsd license": "BSD-3-Clause",
    "mit license": "MIT",
    "mit style": "MIT",
    "mozilla public license 2.0 (mpl 2.0)": "MPL-2.0",
    "python software foundation license": "PSF-2.0",
}
"""What packages call their licence that do not use SPDX."""

_LONGEST_NAME = 60
"""Characters; a longer licence field holds the text of the licence."""

RECORDER = """
import atexit, json, os, socket, sys
if "bcapscope.capture.sniffer" not in " ".join(sys.orig_argv):
    del socket.AF_PACKET  # so that live capture is done as on systems without packet sockets
def record():
    path = os.path.join({folder!r}, str(os.getpid()))
    with open(path + ".part", "w") as file:
        maps = {{line.split(None, 5)[5].strip() for line in open("/proc/self/maps") if line.count("/")}}
        json.dump({{"argv": sys.orig_argv, "modules": sorted(sys.modules), "maps": sorted(maps)}}, file)
    os.rename(path + ".part", path + ".json")
atexit.register(record)
"""


class Row(NamedTuple):
    """A line of the table.

    Attributes:
        package: its name.
        licence: SPDX, perhaps with an explanation behind a semicolon.
        extra: that needs it; "core" for every installation.
        with_scapy: whether it may be loaded beside scapy.
    """

    package: str
    licence: str
    extra: str
    with_scapy: bool

    @property
    def identifiers(self) -> set[str]:
        """The licences by their SPDX identifiers."""
        return set(
            re.findall(r"[A-Za-z0-9][A-Za-z0-9.+]*(?:-[A-Za-z0-9.+]+)+|MIT|Zlib|0BSD|ISC", self.licence)
        )


def rows() -> dict[str, Row]:
    """Read the table."""
    found = {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| ") and len(cells) == 4 and cells[0] != "Package":
            row = Row(cells[0], cells[1], cells[2], {"yes": True, "no": False}[cells[3]])
            assert row.package not in found, f"{row.package} is there twice"
            found[row.package] = row
    return found


def needed(extra: str) -> set[str]:
    """Return all packages that bcapscope needs with an extra, on any system."""
    found: set[str] = set()
    for system in SYSTEMS:
        waiting = [("bcapscope", extra)]
        seen = set()
        while waiting:
            name, wanted = waiting.pop()
            if (name, wanted) in seen:
                continue
            seen.add((name, wanted))
            try:
                lines = metadata.requires(name) or []
            except metadata.PackageNotFoundError:  # not needed on this system
                lines = []
            for requirement in map(Requirement, lines):
                if requirement.marker is None or requirement.marker.evaluate({**system, "extra": wanted}):
                    each = canonicalize_name(requirement.name)
                    waiting += [(each, extra) for extra in ("", *requirement.extras)]
        found |= {name for name, _ in seen}
    return found - {"bcapscope"}


def is_installed(extra: str) -> bool:
    """Return whether every package is installed that an extra names itself."""
    for requirement in map(Requirement, metadata.requires("bcapscope") or ()):
        marker = requirement.marker
        if extra and (
            marker is None or marker.evaluate({"extra": ""}) or not marker.evaluate({"extra": extra})
        ):
            continue
        try:
            metadata.version(requirement.name)
        except metadata.PackageNotFoundError:
            return False
    return True


def stated(name: str) -> set[str]:
    """Return the licences that an installed package states, as SPDX identifiers."""
    data = metadata.metadata(name)
    classifiers = [
        line.rpartition(" :: ")[2] for line in data.get_all("Classifier") or () if "License ::" in line
    ]
    named = "".join(data.get_all("License") or ()).strip().removeprefix("UNKNOWN")
    expressions = data.get_all("License-Expression") or []
    if expressions:
        texts = expressions
    elif named and len(named) < _LONGEST_NAME:
        texts = [named]
    else:
        texts = [text for text in classifiers if text.lower() in SPDX]
    known = [SPDX.get(text.lower(), text) for text in texts]
    return {part.strip() for text in known for part in re.split(r" AND | OR |[()]", text) if part.strip()}


with_all_packages = pytest.mark.skipif(
    find_spec("grimp") is None,
    reason="the table lists the packages of the extra test, which is not installed",
)


@with_all_packages
def test_the_table_lists_every_dependency_and_who_needs_it() -> None:
    installed = [extra for extra in EXTRAS if not extra or is_installed(extra)]
    expected: dict[str, str] = {}
    for extra in installed:
        for name in needed(extra):
            expected.setdefault(name, extra or "core")
    listed = {row.package: row.extra for row in rows().values()}
    assert {extra or "core" for extra in EXTRAS} == set(listed.values())
    assert {name: extra for name, extra in listed.items() if extra in {*expected.values()}} == expected


@with_all_packages
def test_the_table_has_the_licences_that_packages_state() -> None:
    for row in rows().values():
        with suppress(metadata.PackageNotFoundError):  # not needed on this system
            assert stated(row.package) <= row.identifiers, row.package


def test_the_table_keeps_from_scapy_what_is_only_under_the_apache_license() -> None:
    for row in rows().values():
        only = "Apache-2.0" in row.licence and not re.search(r"Apache-2.0 OR|OR Apache-2.0", row.licence)
        assert row.with_scapy is not only, row.package


@contextmanager
def recorded(folder: Path) -> Iterator[dict[str, str]]:
    """Give an environment in which every Python process of ours writes down at its end what it has loaded."""
    (folder / "sitecustomize.py").write_text(RECORDER.format(folder=str(folder)))
    yield {**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{Path(__file__).parent.parent}"}


@contextmanager
def traffic() -> Iterator[int]:
    """Send requests to a port of loopback for the length of a block."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client,
    ):
        server.bind(("127.0.0.1", 0))
        stopping = threading.Event()

        def send() -> None:
            while not stopping.wait(0.02):
                client.sendto(request(1), server.getsockname())

        thread = threading.Thread(target=send)
        thread.start()
        try:
            yield server.getsockname()[1]
        finally:
            stopping.set()
            thread.join()


def live_commands() -> list[str]:
    """Name the commands that capture on an interface."""
    return [
        name
        for name in cli.list_commands(click.Context(cli))
        if (command := cli.get_command(click.Context(cli), name)) is not None
        and any(parameter.name == "interface" for parameter in command.params)
    ]


def test_the_commands_that_capture_are_those_that_are_tried() -> None:
    assert sorted(live_commands()) == ["calls", "decode", "diagnose", "tui"]


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("command", ["calls", "decode", "diagnose", "tui"])
def test_no_process_loads_scapy_beside_what_forbids_it(tmp_path: Path, command: str) -> None:
    _require_rights()
    words = [] if command == "tui" else ["-f", 'function ~ "GetTag"']
    pipe = subprocess.PIPE
    with recorded(tmp_path) as environment, traffic() as port:
        if command == "tui":
            environment["TEXTUAL_DRIVER"] = "textual.drivers.web_driver:WebDriver"
        argv = [sys.executable, "-m", "bcapscope", command, "-i", "lo", "-p", f"{port}", *words]
        with subprocess.Popen(argv, stdin=pipe, stdout=pipe, stderr=pipe, env=environment) as process:
            assert process.stdout is not None
            # `diagnose` says nothing about healthy traffic.
            is_silent = command == "diagnose"
            output = process.stderr if is_silent else process.stdout
            wanted = b"capturing on lo" if is_silent else b"GetTag"
            assert output is not None
            seen = b""
            while wanted not in seen:
                data = os.read(output.fileno(), 65536)
                assert data, process.stderr and process.stderr.read()
                seen += data
            if command != "tui":
                process.send_signal(signal.SIGINT)
            process.communicate(timeout=60)  # the screen ends with its input
    together = [_packages(each) for each in _processes(tmp_path, "bcapscope.capture.sniffer")]
    assert sum("scapy" in packages for packages in together) == 1
    assert [packages for packages in together if _is_forbidden(packages)] == []
    if command != "tui":
        assert any("google-re2" in packages for packages in together)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("module", ["re2", "aiohttp", "yarl"])
def test_a_process_that_loads_both_is_found(tmp_path: Path, module: str) -> None:
    pytest.importorskip(module)
    with recorded(tmp_path) as environment:
        argv = [sys.executable, "-c", f"import scapy.packet, {module}  # both"]
        subprocess.run(argv, env=environment, check=True)
    (process,) = _processes(tmp_path, "# both")
    assert _is_forbidden(_packages(process))
    assert not _is_forbidden(_packages({"modules": ["scapy", "bcapscope", "numpy"], "maps": []}))


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_the_scapy_layer_loads_nothing_that_forbids_scapy(tmp_path: Path) -> None:
    program = "import bcapscope.scapy_layer; bcapscope.open('captures/slave-session.pcapng')  # layer"
    with recorded(tmp_path) as environment:
        argv = [sys.executable, "-c", program]
        subprocess.run(argv, env=environment, cwd=PAGE.parent.parent, check=True)
    (process,) = _processes(tmp_path, "# layer")
    assert "scapy" in _packages(process)
    assert not _is_forbidden(_packages(process))


def _is_forbidden(packages: set[str]) -> bool:
    """Tell whether scapy is there beside a package that the table keeps from it."""
    table = rows()
    return "scapy" in packages and any(name in table and not table[name].with_scapy for name in packages)


def _require_rights() -> None:
    with suppress(PermissionError, CaptureError), socket.socket(socket.AF_PACKET, socket.SOCK_RAW):
        return
    pytest.skip("no right to capture here")


def _processes(folder: Path, last: str) -> list[dict[str, list[str]]]:
    """Read what the processes have written down, once the one with `last` among its words has done so."""

    def read() -> list[dict[str, list[str]]]:
        return [json.loads(path.read_text()) for path in folder.glob("*.json")]

    eventually(lambda: any(last in " ".join(each["argv"]) for each in read()), "its end")
    return read()


def _packages(process: dict[str, list[str]]) -> set[str]:
    """Return the packages that a process had loaded, by its modules and by the files mapped into it."""
    owners = metadata.packages_distributions()
    tops = {module.partition(".")[0] for module in process["modules"]}
    tops |= {
        part for path in process["maps"] for part in re.findall(r"site-packages/([^/]+?)(?:\.libs)?/", path)
    }
    tops |= {
        part
        for path in process["maps"]
        for part in re.findall(r"site-packages/([A-Za-z0-9_]+)\.[^/]+$", path)
    }
    return {canonicalize_name(owner) for top in tops for owner in (*owners.get(top, ()), top)}
