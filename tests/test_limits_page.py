"""Every row of the page of limits has a form that the tests of the subpackages compare with the code."""

from __future__ import annotations

from tests.documented_limits import PAGE, documented_limits

ROOMS = ("protocol", "traffic", "proxy", "faults")


def test_every_row_is_compared_with_the_code() -> None:
    rows = [
        line
        for line in PAGE.read_text("utf-8").splitlines()
        if line[:3] not in {"| V", "|--"} and line[:1] == "|"
    ]
    compared = [name for room in ROOMS for name, _ in documented_limits(room)]
    assert [row.rsplit("`", 2)[1] for row in rows] == compared
    assert len(set(compared)) == len(compared)
