"""How a controller is named on the command line."""

from __future__ import annotations

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from tests.cli.run import run_here
from tests.client.server import udp_server


def test_a_port_behind_the_host_counts() -> None:
    with udp_server() as server:
        ran = run_here("ping", f"127.0.0.1:{server.port}", "-n", "1")
    assert ran.code == ExitCode.OK
    assert ran.lines[0].startswith(f"127.0.0.1:{server.port} over UDP: ")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        pytest.param(
            ["a" * 300], f"{'a' * 80}… is not a valid host name or address", id="a name that is too long"
        ),
        pytest.param(
            ["robot..cell"], "robot..cell is not a valid host name or address", id="a part is missing"
        ),
        pytest.param([""], "the host is empty", id="empty"),
        pytest.param([":5007"], ":5007 is not a valid host name or address", id="only a port"),
        pytest.param(["[]"], "[] is not a valid host name or address", id="empty brackets"),
        pytest.param(["robot:x\x1b[31m"], "x\\x1b[31m is not a port", id="a word for a port"),
        pytest.param(["robot:65536"], "65536 is not a port", id="a port beyond the last"),
        pytest.param(
            ["robot:5007", "-p", "5008"],
            "the port in robot:5007 differs from --port 5008; give only one port",
            id="two",
        ),
    ],
)
def test_what_names_no_controller_is_told(words: list[str], reason: str) -> None:
    ran = run_here("ping", *words)
    assert ran.code == ExitCode.USAGE
    assert reason in ran.err
