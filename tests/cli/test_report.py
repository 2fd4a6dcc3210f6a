"""``bcapscope report`` from the outside, and in a browser where there is one."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from tests.cli.run import CAPTURES, run, run_here

LOST = CAPTURES / "slave-mode-lost.pcapng"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def test_a_page_is_written(tmp_path: Path) -> None:
    out = tmp_path / "report.html"
    ran = run_here("report", LOST, "-o", out)
    assert (ran.code, ran.out) == (ExitCode.OK, "")
    page = out.read_text("utf-8")
    assert page.startswith("<!DOCTYPE html>")
    assert "<title>b-CAP report: slave-mode-lost.pcapng</title>" in page
    assert str(tmp_path) not in page
    assert str(CAPTURES) not in page
    assert len(page) < 6_000_000


def test_the_same_capture_gives_the_same_page(tmp_path: Path) -> None:
    first = run("report", LOST, "-o", "-").out
    run_here("report", LOST, "-o", tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text("utf-8") == first


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_no_room_for_the_page_is_told_in_a_sentence() -> None:
    with Path("/dev/full").open("wb") as full:
        argv = [sys.executable, "-m", "bcapscope", "report", str(LOST), "-o", "-"]
        done = subprocess.run(argv, stdout=full, stderr=subprocess.PIPE, check=False)
    assert done.returncode == ExitCode.UNWRITABLE
    assert (
        done.stderr.decode().splitlines()[-1]
        == "Error: cannot write to standard output: no space left on device"
    )


def test_nothing_is_overwritten_unless_told(tmp_path: Path) -> None:
    out = tmp_path / "report.html"
    out.write_text("mine")
    ran = run_here("report", LOST, "-o", out)
    assert (ran.code, out.read_text()) == (ExitCode.UNWRITABLE, "mine")
    assert "exists already. Add --force to overwrite it" in ran.err
    assert run_here("report", LOST, "-o", out, "--force").code == ExitCode.OK
    assert out.read_text("utf-8").startswith("<!DOCTYPE html>")
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


def test_several_captures_are_one_report() -> None:
    page = run_here("report", LOST, CAPTURES / "retry-story.pcapng", "-o", "-").out
    assert "<title>b-CAP report: slave-mode-lost.pcapng, retry-story.pcapng</title>" in page


def test_a_filter_chooses_calls_and_the_page_says_so() -> None:
    page = run_here("report", LOST, "-o", "-", "-f", 'function ~ "<b>|Service"').out
    assert (
        "This page covers only calls that match this filter: function ~ &#34;&lt;b&gt;|Service&#34;" in page
    )
    assert "slvmove-outside-slave-mode" not in page
    assert "slvmove-outside-slave-mode" in run_here("report", LOST, "-o", "-", "-f", "command == slvMove").out


def test_a_damaged_capture_is_told_on_the_page(tmp_path: Path) -> None:
    cut = tmp_path / "cut.pcapng"
    cut.write_bytes(LOST.read_bytes()[:5000])
    ran = run_here("report", cut, "-o", "-")
    assert ran.code == ExitCode.DAMAGED
    assert "A capture is damaged or incomplete" in ran.out


def test_without_bcap_there_is_no_page(tmp_path: Path) -> None:
    empty = tmp_path / "empty.pcap"
    empty.write_bytes(bytes.fromhex("d4c3b2a1020004000000000000000000ffff000001000000"))
    ran = run_here("report", empty, "-o", tmp_path / "report.html")
    assert ran.code == ExitCode.NO_DATA
    assert ran.err.splitlines()[-1] == "no b-CAP found, so no report was written"
    assert not (tmp_path / "report.html").exists()
    ran = run_here("report", tmp_path / "missing.pcap", "-o", tmp_path / "report.html")
    assert ran.code == ExitCode.UNREADABLE


@pytest.mark.parametrize("package", ["jinja2", "plotly"])
def test_a_missing_package_is_named_with_the_way_to_get_it(package: str, tmp_path: Path) -> None:
    (tmp_path / package).mkdir()
    missing = f"raise ModuleNotFoundError(\"No module named '{package}'\", name='{package}')\n"
    (tmp_path / package / "__init__.py").write_text(missing)
    root = str(Path(__file__).parent.parent.parent)
    ran = run("report", LOST, "-o", tmp_path / "report.html", PYTHONPATH=f"{tmp_path}:{root}")
    assert ran.code == ExitCode.NOT_INSTALLED
    assert ran.err == (f"{package} is not installed. Install it with: pip install 'bcapscope[report]'\n")


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
@pytest.mark.parametrize("name", ["slave-mode-lost.pcapng", "malformed.pcapng"])
def test_a_browser_draws_every_picture(name: str, tmp_path: Path) -> None:
    out = tmp_path / "report.html"
    run_here("report", CAPTURES / name, "-o", out)
    words = ("--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=30000", "--dump-dom")
    quiet = ("--disable-background-networking", "--disable-component-update", "--disable-sync")
    log = ("--enable-logging=stderr", f"--user-data-dir={tmp_path / 'profile'}")
    argv = [str(CHROMIUM), *words, *quiet, *log, out.as_uri()]
    done = subprocess.run(argv, capture_output=True, check=True, timeout=100)
    dom = done.stdout.decode()
    complaints = [line for line in done.stderr.decode().splitlines() if "CONSOLE" in line]
    assert complaints == []
    plots = re.findall(r'<div class="[^"]*"(?= data-from=)', dom)
    assert plots
    assert all("js-plotly-plot" in plot for plot in plots)
    assert dom.count('class="xtick"') > 3 * len(plots)
