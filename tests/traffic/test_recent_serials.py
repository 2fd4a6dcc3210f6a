"""How many serials are remembered."""

from __future__ import annotations

import pytest

from bcapscope.traffic.recent_serials import RecentSerials


@pytest.mark.parametrize("count", [1, 1023, 1024, 1025, 2046, 2047, 2048, 2049, 5000])
def test_the_latest_thousand_serials_are_remembered_and_at_most_twice_as_many(count: int) -> None:
    table: RecentSerials[str] = RecentSerials()
    for serial in range(count):
        table.put(serial, f"value {serial}")
    remembered = [serial for serial in range(count) if table.get(serial) == f"value {serial}"]
    assert remembered == list(range(count - len(remembered), count))
    assert min(count, 1024) <= len(remembered) <= 2048


def test_a_serial_that_comes_again_has_its_latest_value() -> None:
    table: RecentSerials[str] = RecentSerials()
    table.put(1, "old")
    for serial in range(2, 1100):
        table.put(serial, "other")
    assert table.get(1) == "old"
    table.put(1, "new")
    assert table.get(1) == "new"
