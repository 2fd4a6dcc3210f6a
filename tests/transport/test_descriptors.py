"""File descriptors that are held back."""

from __future__ import annotations

import errno
import os
import socket
import subprocess
import sys

import pytest

from bcapscope.transport.descriptors import (
    SpareDescriptors,
    accept_connection,
    is_out_of_descriptors,
    wait_readable,
)


def test_what_was_given_is_taken_back_when_there_is_some(monkeypatch: pytest.MonkeyPatch) -> None:
    spares = SpareDescriptors(2)
    assert not spares.release_one()
    assert spares.refill()
    assert not spares.release_one(keep=2)
    assert spares.release_one(keep=1)
    with monkeypatch.context() as patched:
        patched.setattr(os, "open", _refuse)
        assert not spares.refill()
        assert spares.release_one()
        assert not spares.release_one()
    assert spares.refill()
    spares.close()
    assert not spares.release_one()
    assert spares.refill()  # of none
    assert not spares.release_one()


def test_a_system_without_descriptors_gives_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "open", _refuse)
    spares = SpareDescriptors(2)
    assert not spares.refill()
    assert not spares.release_one()


@pytest.mark.parametrize(
    ("number", "expected"), [(errno.EMFILE, True), (errno.ENFILE, True), (errno.ECONNREFUSED, False)]
)
def test_which_errors_mean_that_none_is_left(number: int, expected: bool) -> None:
    assert is_out_of_descriptors(OSError(number, "")) is expected


def test_the_limit_is_raised_as_far_as_the_user_may() -> None:
    code = (
        "import resource\n"
        "from bcapscope.transport.descriptors import raise_descriptor_limit\n"
        "limits = lambda: print(*resource.getrlimit(resource.RLIMIT_NOFILE))\n"
        "resource.setrlimit(resource.RLIMIT_NOFILE, (100, 200))\n"
        "for count in (50, 150, 300):\n"
        "    raise_descriptor_limit(count)\n"
        "    limits()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert done.stdout.splitlines() == ["100 200", "150 200", "200 200"]


def _refuse(*_: object) -> int:
    raise OSError(errno.EMFILE, "")


def test_without_descriptors_nothing_is_freed_unless_somebody_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    freed: list[bool] = []

    def free() -> bool:
        freed.append(True)
        monkeypatch.undo()
        return True

    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.setblocking(False)
        monkeypatch.setattr(socket.socket, "accept", _refuse)
        assert accept_connection(listener, free) is None
        assert not freed
        with socket.create_connection(listener.getsockname()) as client:
            assert wait_readable(listener.fileno(), 20)
            with pytest.raises(OSError, match=str(errno.EMFILE)):
                accept_connection(listener, lambda: False)
            accepted = accept_connection(listener, free)
            assert accepted is not None
            assert accepted[1] == client.getsockname()
            accepted[0].close()
        assert freed == [True]


@pytest.mark.skipif(sys.platform == "win32", reason="its numbers are no small ones")
def test_a_descriptor_of_any_number_can_be_waited_for() -> None:
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    number = 3000
    if hard != resource.RLIM_INFINITY and hard <= number:
        pytest.skip("there are no such numbers")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, number + 1), hard))
    reader, writer = os.pipe()
    try:
        os.dup2(reader, number)
        assert not wait_readable(number, 0.001)
        os.write(writer, b"x")
        assert wait_readable(number, 1)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        for each in (reader, writer, number):
            os.close(each)
