"""Results for people who have to do something about them."""

from __future__ import annotations

import pytest

from bcapscope.render.result_advice import result_advice


def test_a_success_is_one_line() -> None:
    assert list(result_advice(0)) == ["S_OK 0x00000000 done"]


@pytest.mark.parametrize("code", [0x84201482, 0x84201482 - (1 << 32)])
def test_an_error_has_meaning_level_and_advice(code: int) -> None:
    head, details, what_to_do = result_advice(code)
    assert head.startswith("0x84201482 ")
    assert details == "level 4, all axes stopped, motor off; motion and path"
    assert what_to_do


def test_a_code_that_is_not_known_is_marked_as_a_guess() -> None:
    lines = list(result_advice(0x83291234))
    assert "the meaning is a guess" in lines[1]
