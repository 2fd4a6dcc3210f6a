"""The pytest plugin of bcapscope: fixtures for the tests of b-CAP clients.

pytest loads this module in every test run. Only tests that use a fixture import the rest
of bcapscope.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from bcapscope.testing.embedded_proxy import EmbeddedProxy
    from bcapscope.testing.embedded_simulator import EmbeddedSimulator
    from bcapscope.testing.recording_context import RecordingContext

_SOURCES = pytest.StashKey[dict[str, "RecordingContext"]]()
"""The simulators and proxies of a test, by the name of the fixture."""


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers",
        "bcap(profile=None, scenario=None, faults=(), seed=None): set up the fixture bcap_simulator; the "
        "arguments are those of bcapscope.Simulator. If a test uses bcap_proxy, the proxy injects the "
        "faults.",
    )


@pytest.fixture
def bcap_simulator(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[EmbeddedSimulator]:
    """A simulated b-CAP controller with `.host`, `.port`, `.calls`, `.findings` and `.recording`.

    Choose profile, scenario, faults and seed with @pytest.mark.bcap.
    """
    from bcapscope.testing.embedded_simulator import EmbeddedSimulator

    options = _marked_options(request)
    if "bcap_proxy" in request.fixturenames:
        options.pop("faults", None)
    with EmbeddedSimulator(**options, record=tmp_path / "bcap_simulator.pcapng") as simulator:
        _remember(request, simulator)
        yield simulator


@pytest.fixture
def bcap_proxy(
    request: pytest.FixtureRequest, tmp_path: Path, bcap_simulator: EmbeddedSimulator
) -> Iterator[EmbeddedProxy]:
    """A proxy in front of `bcap_simulator` with `.host`, `.port`, `.calls`, `.findings` and `.recording`.

    The proxy injects the faults of @pytest.mark.bcap. The proxy's recording shows both sides of the proxy:
    the traffic without the faults and the traffic with the faults.
    """
    from bcapscope.testing.embedded_proxy import EmbeddedProxy

    options, to = _marked_options(request), f"{bcap_simulator.host}:{bcap_simulator.port}"
    faults, seed = options.get("faults", ()), options.get("seed", 0)
    with EmbeddedProxy(to=to, faults=faults, seed=seed, record=tmp_path / "bcap_proxy.pcapng") as proxy:
        _remember(request, proxy)
        yield proxy


def _marked_options(request: pytest.FixtureRequest) -> dict[str, Any]:
    """Return the options of all markers; the marker closest to the test wins."""
    options: dict[str, Any] = {}
    for marker in reversed(list(request.node.iter_markers("bcap"))):
        unknown = sorted(set(marker.kwargs) - {"profile", "scenario", "faults", "seed"})
        if marker.args or unknown:
            given = ", ".join([*map(repr, marker.args), *unknown])
            raise pytest.UsageError(
                f"@pytest.mark.bcap accepts profile=, scenario=, faults= and seed=, but not {given}"
            )
        options |= marker.kwargs
    return options


def _remember(request: pytest.FixtureRequest, source: RecordingContext) -> None:
    request.node.stash.setdefault(_SOURCES, {})[request.fixturename or ""] = source


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if report.failed and report.when == "call":
        for name, source in item.stash.get(_SOURCES, {}).items():
            from bcapscope.testing.recorded_traffic import failure_report_lines

            lines = failure_report_lines(source.traffic(), source.recording)
            report.sections.append((f"b-CAP: {name}", "\n".join(lines)))
    return report
