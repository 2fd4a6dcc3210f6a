"""File descriptors that are held back."""

from __future__ import annotations

import errno
import os

import pytest

from bcapscope.transport.descriptors import SpareDescriptors, none_left


def test_what_was_given_is_taken_back_when_there_is_some(monkeypatch: pytest.MonkeyPatch) -> None:
    spares = SpareDescriptors(2)
    assert spares.fill()
    assert spares.give()
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


def _refuse(*_: object) -> int:
    raise OSError(errno.EMFILE, "")
