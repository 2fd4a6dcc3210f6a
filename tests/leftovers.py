"""What a test may not leave changed, as it would change the tests after it in the same process."""

from __future__ import annotations

import gc
import locale
import os
import resource
import signal
import socket
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

import pytest

from bcapscope.tui.reader_language import current_language

_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGPIPE", "SIGTSTP", "SIGCONT", "SIGWINCH", "SIGCHLD")
_FROZEN = 1000
"""Objects set aside from collecting; Python 3.12 does so with some hundred of its own."""

_LIMITS = ("RLIMIT_NOFILE", "RLIMIT_FSIZE", "RLIMIT_AS", "RLIMIT_CORE")


def _environment() -> dict[bytes, bytes]:
    """Return the environment without the name of the test, which pytest itself sets."""
    return {name: value for name, value in os.environb.items() if name != b"PYTEST_CURRENT_TEST"}


_LOOKS: Mapping[str, Callable[[], object]] = MappingProxyType(
    {
        "the folder": os.getcwd,
        "the environment": _environment,
        "the locale": lambda: locale.setlocale(locale.LC_ALL),
        "sys.argv": lambda: list(sys.argv),
        "sys.path": lambda: list(sys.path),
        "the switch interval": sys.getswitchinterval,
        "the timeout of sockets": socket.getdefaulttimeout,
        "collecting garbage": lambda: (gc.isenabled(), gc.get_threshold(), gc.get_freeze_count() > _FROZEN),
        "the priority": lambda: os.getpriority(os.PRIO_PROCESS, 0),
        "the scheduler": lambda: os.sched_getscheduler(0) if sys.platform == "linux" else None,
        "the processors": lambda: os.sched_getaffinity(0) if sys.platform == "linux" else None,
        "the limits": lambda: [resource.getrlimit(getattr(resource, name)) for name in _LIMITS],
        "the handlers of signals": lambda: [signal.getsignal(_number(name)) for name in _SIGNALS],
        "the language of the screen": current_language,
    }
)


def _number(name: str) -> Any:
    return getattr(signal, name)


@contextmanager
def nothing_left() -> Iterator[None]:
    """Fail if something is not as it was before the block."""
    before = {name: look() for name, look in _LOOKS.items()}
    yield
    changed = [
        f"{name}: {before[name]} before, {now} after"
        for name, look in _LOOKS.items()
        if (now := look()) != before[name]
    ]
    if changed:
        pytest.fail("\n".join(("the test left something changed", *changed)))
