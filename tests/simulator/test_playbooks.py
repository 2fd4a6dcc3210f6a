"""Each playbook on each profile that it is for."""

from __future__ import annotations

import pytest

from tests.simulator.performance import Performance
from tests.simulator.playbook import playbooks, read

BOOKS = tuple(playbooks())


@pytest.mark.parametrize(("name", "profile"), BOOKS)
def test_a_client_is_answered_as_its_playbook_says(name: str, profile: str) -> None:
    book = read(name, profile)
    performance = Performance(book, profile)
    for step in book.steps:
        performance.play(step)
