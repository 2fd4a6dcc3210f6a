"""YAML as events: what is no YAML, and what is nested too deep."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

import bcapscope
from bcapscope.faults.yaml_events import MAX_LEVELS, YamlError, yaml_events


@pytest.mark.parametrize("opening", ["[", "{a: ", "- ", "? "])
def test_no_depth_breaks_it(opening: str) -> None:
    with pytest.raises(YamlError, match=f"^more than {MAX_LEVELS} levels$") as caught:
        list(yaml_events(opening * 200_000))
    assert caught.value.line == 1


def test_what_is_deep_enough_is_read() -> None:
    assert len(list(yaml_events("[" * MAX_LEVELS + "]" * MAX_LEVELS))) == 2 * MAX_LEVELS + 4
    assert len(list(yaml_events("[]\n---\n" * 100))) > 400


@pytest.mark.parametrize(
    ("data", "problem", "place"),
    [
        ("a: b: c", "this is not YAML: mapping values are not allowed", (1, 5)),
        ("a:\n  - [1, 2\n", "this is not YAML: ", (3, 1)),
        (b"\xff\xfe\x00", "this is not YAML: ", (0, 0)),
        ("\x07", "this is not YAML: ", (0, 0)),
    ],
)
def test_what_is_no_yaml(data: bytes | str, problem: str, place: tuple[int, int]) -> None:
    with pytest.raises(YamlError) as caught:
        list(yaml_events(data))
    assert str(caught.value).startswith(problem)
    assert "\n" not in str(caught.value)
    assert (caught.value.line, caught.value.column) == place


@given(st.binary(max_size=100) | st.text(st.sampled_from("[]{}:-? a&*!|>#'\n"), max_size=100))
def test_anything_gives_events_or_one_error(data: bytes | str) -> None:
    with suppress(YamlError):
        assert isinstance(list(yaml_events(data))[-1], yaml.StreamEndEvent)


def test_nothing_reads_yaml_in_another_way() -> None:
    root = Path(bcapscope.__path__[0])
    other = re.compile(r"yaml\.(decode|parse|scan|(\w+_)?(load|compose)(_all)?)\(")
    found = {
        path.relative_to(root).as_posix() for path in root.rglob("*.py") if other.search(path.read_text())
    }
    assert found == {"faults/yaml_events.py"}
