"""How a controller is named."""

from __future__ import annotations

import pytest

from bcapscope.client.controller_target import split_host_port


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("", "", ""),
        ("robot", "robot", ""),
        ("192.168.0.1", "192.168.0.1", ""),
        ("192.168.0.1:5007", "192.168.0.1", "5007"),
        ("robot:", "robot", ""),
        ("robot:x", "robot", "x"),
        (":5007", "", "5007"),
        ("::1", "::1", ""),
        ("fe80::1%eth0", "fe80::1%eth0", ""),
        ("[::1]", "::1", ""),
        ("[::1]:5007", "::1", "5007"),
        ("[::1", "::1", ""),
    ],
)
def test_a_port_behind_the_host(text: str, host: str, port: str) -> None:
    assert split_host_port(text) == (host, port)
