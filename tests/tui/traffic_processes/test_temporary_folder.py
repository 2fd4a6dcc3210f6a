"""Folders that are gone when the screen is, however it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from bcapscope.tui.traffic_processes.temporary_folder import TemporaryFolder
from tests.cli.run import CAPTURES

pytestmark = pytest.mark.lifecycle

LIMIT = 30.0
_SCREEN = """
from bcapscope.tui.traffic_processes.process_messages import ReadJob
from bcapscope.tui.traffic_processes.traffic_feed import TrafficFeed
feed = TrafficFeed(ReadJob(path={path!r}, follow=True))
while not feed.open_journal():
    pass
print("open", flush=True)
input()
"""


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("platformdirs.user_cache_path", lambda *names, **more: tmp_path)
    return tmp_path


def left(cache: Path) -> list[Path]:
    folders = (Path(above, name) for above, names, _ in os.walk(cache) for name in names)
    return [each for each in folders if each.name.startswith("traffic-")]


def until(true: Callable[[], object]) -> None:
    end = time.monotonic() + LIMIT
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_folder_is_removed_with_all_in_it(cache: Path) -> None:
    with closing(TemporaryFolder()) as folder:
        (folder.path / "deep" / "er").mkdir(parents=True)
        (folder.path / "deep" / "file").write_text("x")
        assert left(cache) == [folder.path]
    assert left(cache) == []


def test_closing_twice_and_after_its_helper_died_is_fine(cache: Path) -> None:
    folder = TemporaryFolder()
    folder._cleanup_process.kill()
    folder._cleanup_process.wait(LIMIT)
    folder.close()
    folder.close()


@pytest.mark.skipif(sys.platform == "win32", reason="no such signal, and no such place of a cache")
def test_a_screen_that_is_killed_leaves_nothing(cache: Path) -> None:
    code = _SCREEN.format(path=str(CAPTURES / "retry-story.pcapng"))
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache), "HOME": str(cache)}
    with subprocess.Popen(
        [sys.executable, "-c", code], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as screen:
        assert screen.stdout is not None
        assert screen.stdout.readline() == b"open\n"
        assert len(left(cache)) == 1
        screen.send_signal(signal.SIGKILL)
    until(lambda: left(cache) == [])


@pytest.mark.skipif(sys.platform == "win32", reason="there it cannot be told who still runs")
def test_folders_of_processes_that_died_are_removed(cache: Path) -> None:
    (cache / "traffic-99999999-x").mkdir(parents=True)
    (cache / f"traffic-{os.getpid()}-y").mkdir()
    (cache / "traffic-notes").mkdir()
    made = TemporaryFolder()
    made.close()
    assert {path.name for path in cache.glob("traffic-*")} == {
        f"traffic-{os.getpid()}-y",
        "traffic-notes",
    }
