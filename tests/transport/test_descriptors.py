"""File descriptors that are held back."""

from __future__ import annotations

import errno
import os
import subprocess
import sys

import pytest

from bcapscope.transport.descriptors import SpareDescriptors, none_left


def test_what_was_given_is_taken_back_when_there_is_some(monkeypatch: pytest.MonkeyPatch) -> None:
    spares = SpareDescriptors(2)
    assert not spares.give()
    assert spares.fill()
    assert not spares.give(keep=2)
    assert spares.give(keep=1)
    with monkeypatch.context() as patched:
        patched.setattr(os, "open", _refuse)
        assert not spares.fill()
        assert spares.give()
        assert not spares.give()
    assert spares.fill()
    spares.close()
    assert not spares.give()
    assert spares.fill()  # of none
    assert not spares.give()


def test_a_system_without_descriptors_gives_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "open", _refuse)
    spares = SpareDescriptors(2)
    assert not spares.fill()
    assert not spares.give()


@pytest.mark.parametrize(
    ("number", "expected"), [(errno.EMFILE, True), (errno.ENFILE, True), (errno.ECONNREFUSED, False)]
)
def test_which_errors_mean_that_none_is_left(number: int, expected: bool) -> None:
    assert none_left(OSError(number, "")) is expected


def test_the_limit_is_raised_as_far_as_the_user_may() -> None:
    code = (
        "import resource\n"
        "from bcapscope.transport.descriptors import allow_descriptors\n"
        "limits = lambda: print(*resource.getrlimit(resource.RLIMIT_NOFILE))\n"
        "resource.setrlimit(resource.RLIMIT_NOFILE, (100, 200))\n"
        "for count in (50, 150, 300):\n"
        "    allow_descriptors(count)\n"
        "    limits()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert done.stdout.splitlines() == ["100 200", "150 200", "200 200"]


def _refuse(*_: object) -> int:
    raise OSError(errno.EMFILE, "")
