"""Listeners that start again, and programs that must not take over their port."""

from __future__ import annotations

import socket
import sys

import pytest

from bcapscope.transport.listening import allow_restart


@pytest.mark.parametrize(("system", "is_set"), [("linux", True), ("darwin", True), ("win32", False)])
def test_only_windows_needs_no_option(monkeypatch: pytest.MonkeyPatch, system: str, is_set: bool) -> None:
    monkeypatch.setattr(sys, "platform", system)
    with socket.socket() as listener:
        allow_restart(listener)
        assert bool(listener.getsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR)) is is_set
