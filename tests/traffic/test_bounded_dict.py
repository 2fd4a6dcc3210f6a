"""A dictionary that forgets what was set first."""

from __future__ import annotations

from bcapscope.traffic.bounded_dict import BoundedDict


def test_the_oldest_entry_goes() -> None:
    table: BoundedDict[str, int] = BoundedDict(2)
    for key in "abc":
        table[key] = 0
    assert list(table) == ["b", "c"]


def test_an_entry_that_is_set_again_is_the_newest() -> None:
    table: BoundedDict[str, int] = BoundedDict(2)
    for number, key in enumerate("abac"):
        table[key] = number
    assert table == {"a": 2, "c": 3}
