"""A small attack on the guard, and proof that it is one."""

from __future__ import annotations

from tests.security.guardattacks import guard_attacks, unguarded


def test_a_read_only_proxy_lets_nothing_through_that_energises_or_moves() -> None:
    guard_attacks(seconds=1.0)


def test_without_a_guard_the_same_requests_affect_the_robot() -> None:
    assert unguarded() > 0
