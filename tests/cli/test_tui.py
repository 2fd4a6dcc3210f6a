"""``bcapscope tui`` in a terminal of its own that goes away."""

from __future__ import annotations

import os
import select
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cli.late_retry import late_retry
from tests.cli.run import CAPTURES

pytestmark = pytest.mark.lifecycle

pty = pytest.importorskip("pty", reason="there are no pseudo-terminals here")
fcntl, termios = pytest.importorskip("fcntl"), pytest.importorskip("termios")

LIMIT = 40.0


@pytest.mark.parametrize("leads", [True, False], ids=["its own terminal", "somebody else's terminal"])
def test_it_ends_when_the_terminal_is_closed(leads: bool, tmp_path: Path) -> None:
    # The leader of the terminal's session is sent SIGHUP; nobody tells the others.
    near, far = pty.openpty()
    argv = [sys.executable, "-m", "bcapscope", "tui", str(CAPTURES / "slave-session.pcapng")]
    if leads:
        argv = [sys.executable, "-c", f"import os, pty; os.login_tty({far}); os.execv({argv[0]!r}, {argv!r})"]
    env = {**os.environ, "TERM": "xterm-256color", "HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)}
    with subprocess.Popen(
        argv, stdin=far, stdout=far, stderr=far, pass_fds=[far], env=env, start_new_session=True
    ) as process:
        os.close(far)
        try:
            _read_until(near, b"Service_Start")
            os.close(near)
            assert process.wait(LIMIT) == 0
        finally:
            process.kill()
    left = [path for path in tmp_path.rglob("*") if "traffic-" in path.name]
    assert left == []


def test_the_place_of_a_capture_decides_whether_a_reply_was_lost(tmp_path: Path) -> None:
    near, far = pty.openpty()
    fcntl.ioctl(far, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 200, 0, 0))
    argv = [sys.executable, "-m", "bcapscope", "tui", late_retry(tmp_path).name, "--taken-at", "client"]
    env = {**os.environ, "TERM": "xterm-256color", "HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)}
    env |= {"COLUMNS": "200", "LINES": "40"}  # pytest-xdist may set a smaller size
    with subprocess.Popen(
        argv, stdin=far, stdout=far, stderr=far, cwd=tmp_path, env=env, start_new_session=True
    ) as process:
        os.close(far)
        try:
            _read_until(near, b"slvMove")
            _read_until(near, b"reply lost", press=b"2")
            os.close(near)
            assert process.wait(LIMIT) == 0
        finally:
            process.kill()


@pytest.mark.parametrize("source", [["127.0.0.1"], ["--sim"], ["--proxy", "127.0.0.1:9"], []])
def test_the_place_of_a_capture_needs_a_capture(source: list[str], tmp_path: Path) -> None:
    env = {**os.environ, "HOME": str(tmp_path), "LC_ALL": "C.UTF-8"}
    argv = [sys.executable, "-m", "bcapscope", "tui", *source, "--taken-at", "client"]
    done = subprocess.run(argv, env=env, capture_output=True, text=True, check=False, timeout=LIMIT)
    assert done.returncode == 2
    assert "--taken-at needs a capture: give FILE or -i" in done.stderr


def test_no_room_for_a_journal_is_told_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    env = {**os.environ, "HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "file")}
    for words in ([str(CAPTURES / "slave-session.pcapng")], ["127.0.0.1"], ["--sim"]):
        argv = [sys.executable, "-m", "bcapscope", "tui", *words]
        done = subprocess.run(argv, env=env, capture_output=True, text=True, check=False, timeout=LIMIT)
        assert done.returncode == 6
        assert done.stderr.startswith("cannot create temporary files in ")
        assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "saved", "wanted"),
    [
        ([], "", "no proxy listens for control on"),
        ([], "language: ja", "制御を待ち受けるプロキシがありません"),
        (["--lang", "ja"], "", "制御を待ち受けるプロキシがありません"),
        (["--lang", "en"], "language: ja", "no proxy listens for control on"),
    ],
)
def test_the_option_chooses_the_language_before_the_settings(
    options: list[str], saved: str, wanted: str, tmp_path: Path
) -> None:
    settings = tmp_path / "bcapscope" / "screen.yaml"
    settings.parent.mkdir()
    settings.write_text(saved or "theme: dark")
    env = {**os.environ, "XDG_CONFIG_HOME": str(tmp_path), "LC_ALL": "C.UTF-8"}
    argv = [sys.executable, "-m", "bcapscope", "tui", *options, "--proxy", "127.0.0.1:9"]
    done = subprocess.run(argv, env=env, capture_output=True, text=True, check=False, timeout=LIMIT)
    assert done.returncode == 4
    assert wanted in done.stderr


def _read_until(descriptor: int, wanted: bytes, press: bytes = b"") -> None:
    """Read until the screen shows something. Press a key again whenever the screen does not change."""
    seen, end = b"", time.monotonic() + LIMIT
    while wanted not in seen:
        ready, _, _ = select.select([descriptor], [], [], 1.0 if press else max(0, end - time.monotonic()))
        assert ready or (press and time.monotonic() < end), seen[-2000:]
        if ready:
            seen += os.read(descriptor, 65536)
        else:
            os.write(descriptor, press)


@pytest.mark.parametrize("words", [[], [str(CAPTURES / "slave-session.pcapng")]], ids=["tester", "capture"])
def test_no_terminal_is_told_in_one_sentence(words: list[str], tmp_path: Path) -> None:
    places = {f"XDG_{name}_HOME": str(tmp_path) for name in ("CACHE", "CONFIG", "DATA", "STATE")}
    argv = [sys.executable, "-m", "bcapscope", "tui", *words]
    done = subprocess.run(
        argv,
        env={**os.environ, **places},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
        timeout=LIMIT,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.endswith(
        "Error: the screen needs a terminal. Without a terminal, use decode, calls or diagnose\n"
    )
