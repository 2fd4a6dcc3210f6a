"""Each playbook on each profile that it is for."""

from __future__ import annotations

from pathlib import Path

import pytest

from bcapscope.simulator.profile import PROFILES
from tests.simulator.performance import Performance, Wrong
from tests.simulator.playbook import FOLDER, playbooks, read

BOOKS = tuple(playbooks())


@pytest.mark.parametrize(("name", "profile"), BOOKS)
def test_a_client_is_answered_as_its_playbook_says(name: str, profile: str) -> None:
    book = read(FOLDER / f"{name}.play", profile)
    performance = Performance(book, profile)
    for step in book.steps:
        performance.play(step)


def test_each_profile_has_playbooks_of_each_style() -> None:
    styles = {(name.partition("-")[0], profile) for name, profile in BOOKS}
    assert {style for style, _ in styles} == {"csharp", "old", "python", "rc7", "ros"}
    for style in ("csharp", "old", "python", "ros"):
        assert {profile for found, profile in styles if found == style} == set(PROFILES), style


@pytest.mark.parametrize(
    "line",
    [
        'a: Service_Start "" => EMPTY',
        'a: Service_Start "" => none in 1 ms',
        'a: Service_Start "WDT=5" => none',
        'a: Controller_Execute i4:1 "ClearError" - => 80000900 EMPTY',
        'a: Controller_Connect "" "CaoProv.DENSO.VRC" "localhost" "" => i4:7',
        'a: Controller_Connect "" "CaoProv.DENSO.VRC" "localhost" "" => bstr',
        "a gets: => none",
    ],
)
def test_a_wrong_reply_is_noticed(line: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.play"
    path.write_text(f'profiles: rc8\nclient a: udp own\na: Service_Start "" => none\n{line}\n')
    book = read(path, "rc8")
    performance = Performance(book, "rc8")
    performance.play(book.steps[0])
    with pytest.raises(Wrong, match=r"wrong\.play:4"):
        performance.play(book.steps[1])
