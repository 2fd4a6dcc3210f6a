"""Attacks on listeners and recordings, in a small size."""

from __future__ import annotations

import sys

import pytest

from tests.security import connections, descriptors, fulldisk, halfopen, slow, sources

SECONDS = 0.5

pytestmark = [
    pytest.mark.deep,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="measured by /proc"),
]


def test_silent_connections() -> None:
    connections.withstand(400, SECONDS)


def test_slow_connections() -> None:
    slow.withstand(300, SECONDS, 50)


def test_half_open_connections() -> None:
    halfopen.withstand(300, SECONDS)


def test_datagrams_from_ever_new_ports() -> None:
    sources.withstand(SECONDS, 500)


def test_no_file_descriptors() -> None:
    descriptors.withstand(30, SECONDS)


def test_stops_without_file_descriptors() -> None:
    descriptors.stop_each(12)


@pytest.mark.skipif(not fulldisk.can_mount(), reason="only root can mount a small disk")
def test_full_disks() -> None:
    fulldisk.withstand(100, SECONDS)
