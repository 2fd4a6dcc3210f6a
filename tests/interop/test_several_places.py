"""Captures of one conversation at several places, as in the folder of cases."""

from __future__ import annotations

import json
from collections import Counter
from typing import Any

import pytest

from tests.cli.run import run_here
from tests.shared_folder import SHARED

pytestmark = pytest.mark.interop

CASES = SHARED / "cases"

if not CASES.exists():
    pytest.skip(f"{CASES} is missing: captures of known sessions", allow_module_level=True)

BOTH_LEGS = CASES / "proxy-both-legs.pcapng"


def json_lines(*words: object) -> list[dict[str, Any]]:
    return [json.loads(line) for line in run_here(*map(str, words), "--json").lines]


def test_a_recording_of_the_proxy_shows_each_call_once() -> None:
    calls = json_lines("calls", BOTH_LEGS)
    assert len(calls) == 100
    assert sum(len(call["requests"]) for call in calls) == 118
    assert len({call["client"] for call in calls}) == 1
    assert Counter(call["verdict"] for call in calls if call["retries"]) == {
        "request lost": 10,
        "reply lost": 6,
    }


def test_one_leg_alone_shows_what_was_captured_there() -> None:
    assert len(json_lines("calls", BOTH_LEGS, "--side", "client")) == 100
    assert len(json_lines("calls", BOTH_LEGS, "--side", "controller")) == 103
    frames = json_lines("decode", BOTH_LEGS)
    sides = [json_lines("decode", BOTH_LEGS, "--side", side) for side in ("client", "controller")]
    assert sorted(each["frame"] for side in sides for each in side) == [each["frame"] for each in frames]


def test_both_ends_settle_every_verdict() -> None:
    near, far = CASES / "two-ends-client.pcap", CASES / "two-ends-controller.pcap"
    for paths in ((near, far), (far, near)):
        calls = json_lines("calls", *paths)
        assert len(calls) == 27
        assert Counter(call["verdict"] for call in calls if call["retries"]) == {
            "request lost": 6,
            "reply lost": 1,
        }
        assert all(call["outcome"] == "answered" for call in calls)


def test_a_fault_of_the_proxy_is_the_first_cause() -> None:
    first, *others = json_lines("diagnose", BOTH_LEGS)
    assert (first["rule"], first["consequence_of"]) == ("injected-fault", None)
    assert "the proxy applied its rule drop to" in first["sentence"]
    assert [finding["rule"] for finding in others if finding["consequence_of"] is None] == []
    assert not any("cable" in finding["advice"] for finding in others)
