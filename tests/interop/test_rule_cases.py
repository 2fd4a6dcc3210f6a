"""Captures with one mistake or none each: `diagnose` names the right cause, and nothing that is in order."""

from __future__ import annotations

import pytest

from tests.analysis.scenes import Diagnosed, diagnose_bytes
from tests.shared_folder import SHARED

pytestmark = pytest.mark.interop

CASES = SHARED / "cases"

if not CASES.exists():
    pytest.skip(f"{CASES} is missing: captures with one mistake each", allow_module_level=True)


def _diagnosed(name: str) -> Diagnosed:
    return diagnose_bytes((CASES / name).read_bytes())


def _causes(found: Diagnosed) -> dict[str, str]:
    """Map the rule of each finding that is no note to the rule of its cause, "" for a root cause."""
    causes = (
        "" if (n := each.consequence_of) is None else found.findings[n - 1].rule for each in found.findings
    )
    pairs = zip(found.findings, causes, strict=True)
    return {each.rule: cause for each, cause in pairs if each.severity != "note"}


def test_a_missing_token_explains_all_refusals_after_it() -> None:
    assert _causes(_diagnosed("token-then-refusals.pcap")) == {
        "no-executable-token": "",
        "argument-refused": "no-executable-token",
        "arm-not-taken": "no-executable-token",
        "went-on-after-error": "no-executable-token",
    }


def test_a_long_move_without_wdt_comes_first() -> None:
    assert _causes(_diagnosed("long-move-without-wdt.pcap")) == {
        "long-call-without-wdt": "",
        "client-gave-up": "long-call-without-wdt",
        "busy": "client-gave-up",
    }


def test_an_orderly_shutdown_after_an_error_is_in_order() -> None:
    assert _causes(_diagnosed("orderly-shutdown-after-error.pcap")) == {"over-limit": ""}


def test_an_emergency_stop_in_the_error_list_is_the_root_cause() -> None:
    assert _causes(_diagnosed("emergency-stop-in-error-list.pcap")) == {
        "emergency-stop": "",
        "controller-error": "emergency-stop",
        "slvmove-outside-slave-mode": "controller-error",
        "went-on-after-error": "controller-error",
    }


def test_a_pause_at_standstill_is_healthy() -> None:
    assert _diagnosed("healthy-pause-at-standstill.pcap").findings == ()
