"""The pytest plugin: its fixture, its marker, and the report of a failed test."""

from __future__ import annotations

import pytest

pytest_plugins = ["pytester"]

_CONNECT = """
import bcapscope.client as b, asyncio, pytest
def connect(simulator, provider="CaoProv.DENSO.VRC"):
    async def run():
        async with b.connect(b.over_udp(simulator.host, simulator.port)) as service:
            await service.connect("", provider, "localhost")
    asyncio.run(run())
"""


def _run(pytester: pytest.Pytester, program: str, *options: str) -> pytest.RunResult:
    pytester.makepyfile(_CONNECT + program)
    return pytester.runpytest_subprocess("-p", "no:cacheprovider", "--strict-markers", *options)


def test_the_fixture_needs_no_import(pytester: pytest.Pytester) -> None:
    result = _run(
        pytester,
        """
def test_calls(bcap_simulator):
    connect(bcap_simulator)
    assert bcap_simulator.host == "127.0.0.1"
    assert len(bcap_simulator.calls) == 4
    assert bcap_simulator.recording.name == "bcap_simulator.pcapng"
    assert bcap_simulator.recording.stat().st_size > 500
""",
    )
    result.assert_outcomes(passed=1)
    assert "b-CAP" not in result.stdout.str()


def test_the_report_of_a_failed_test_shows_calls_findings_and_capture(pytester: pytest.Pytester) -> None:
    result = _run(
        pytester,
        """
def test_provider(bcap_simulator):
    connect(bcap_simulator, "Wrong.Provider")
""",
    )
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        [
            "*- b-CAP: bcap_simulator -*",
            "*Service_Start*S_OK*",
            "*Controller_Connect*",
            "*provider-refused*",
            "Capture: *bcap_simulator.pcapng",
        ]
    )


def test_a_long_session_is_shortened(pytester: pytest.Pytester) -> None:
    result = _run(
        pytester,
        """
def test_many(bcap_simulator):
    for _ in range(10):
        connect(bcap_simulator)
    assert False
""",
    )
    result.stdout.fnmatch_lines(["Only the capture shows the 10 calls before these:"])
    assert result.stdout.str().count("S_OK") == 30


def test_the_closest_marker_wins(pytester: pytest.Pytester) -> None:
    result = _run(
        pytester,
        """
@pytest.mark.bcap(profile="rc7", faults=["loss=100% reply"])
class TestLines:
    @pytest.mark.bcap(faults=["drop reply try 1 if command == slvMove"], seed=3)
    def test_own_faults(self, bcap_simulator):
        connect(bcap_simulator)

    def test_inherited(self, bcap_simulator):
        with pytest.raises(TimeoutError):
            connect(bcap_simulator)

@pytest.mark.bcap(scenario="slow-line")
def test_scenario(bcap_simulator):
    connect(bcap_simulator)
""",
    )
    result.assert_outcomes(passed=3)


@pytest.mark.parametrize(
    ("marker", "reason"),
    [
        ("'rc7'", "accepts profile=, scenario=, faults= and seed=, but not 'rc7'"),
        ("port=1", "accepts profile=, scenario=, faults= and seed=, but not port"),
        ("profile='rc6'", "there is no profile 'rc6'"),
    ],
)
def test_a_wrong_marker_is_an_error(pytester: pytest.Pytester, marker: str, reason: str) -> None:
    result = _run(pytester, f"@pytest.mark.bcap({marker})\ndef test_nothing(bcap_simulator):\n    pass\n")
    result.assert_outcomes(errors=1)
    assert reason in result.stdout.str()


def test_the_marker_is_listed(pytester: pytest.Pytester) -> None:
    result = pytester.runpytest_subprocess("--markers")
    result.stdout.fnmatch_lines(["@pytest.mark.bcap(profile=None, *"])


def test_the_proxy_stands_before_the_simulator_and_has_the_faults(pytester: pytest.Pytester) -> None:
    result = _run(
        pytester,
        """
@pytest.mark.bcap(faults=["drop reply try 1"])
def test_proxy(bcap_simulator, bcap_proxy):
    connect(bcap_proxy)
    assert {len(call.attempts) for call in bcap_proxy.calls} == {2}
    assert len(bcap_simulator.calls) == 4
    assert False
""",
    )
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*assert False", "*- b-CAP: bcap_proxy -*", "Capture: *bcap_proxy.pcapng"])
