"""A dictionary that drops its oldest entries."""

from __future__ import annotations

from bcapscope.traffic.bounded_dict import BoundedDict


def test_the_entry_that_was_set_longest_ago_is_dropped_first() -> None:
    table: BoundedDict[str, int] = BoundedDict(3)
    for number, key in enumerate("abcad"):
        table[key] = number
    assert table == {"c": 2, "a": 3, "d": 4}
