"""YAML as text, lists and dictionaries."""

from __future__ import annotations

from contextlib import suppress

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.faults.yaml_events import MAX_LEVELS
from bcapscope.player.trajectory import TrajectoryError
from bcapscope.player.trajectory_documents import read_yaml


@pytest.mark.parametrize(
    ("text", "documents"),
    [
        ("a: 1\nb: [x, 2.5, {c: ~}]\n", [{"a": "1", "b": ["x", "2.5", {"c": "~"}]}]),
        ("---\n1\n---\n- 2\n", ["1", ["2"]]),
        ("a: &x [1]\nb: *x\n", [{"a": ["1"], "b": ["1"]}]),
        ("? [1, 2]\n: 3\n", [{"?": "3"}]),
        ("", []),
        ("# nothing\n", []),
    ],
)
def test_documents(text: str, documents: list[object]) -> None:
    assert list(read_yaml(text.encode())) == documents


def test_what_refers_to_itself() -> None:
    (node,) = read_yaml(b"&a [*a]")
    assert isinstance(node, list)
    assert node[0] is node


@pytest.mark.parametrize("opening", ["[", "{a: ", "- "])
def test_no_depth_breaks_it(opening: str) -> None:
    with pytest.raises(TrajectoryError, match=f"more than {MAX_LEVELS} levels"):
        list(read_yaml((opening * 100_000).encode()))


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (b"a: [1, 2\nb: 3", "line 2, column 2: this is not YAML: "),
        (b"a: *b", "line 1: this is not YAML: *b refers to nothing"),
        (b"\xff\xfe\x00", "this is not YAML: "),
        (b"a: \x01", "this is not YAML: "),
        (b"a: b: c", "line 1, column 5: this is not YAML: "),
    ],
)
def test_what_is_no_yaml(data: bytes, error: str) -> None:
    with pytest.raises(TrajectoryError) as caught:
        list(read_yaml(data))
    assert str(caught.value).startswith(error)
    assert "\n" not in str(caught.value)


PLAIN = st.recursive(
    st.text("abc01.", max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text("abc", min_size=1), inner, max_size=3)
    ),
)


@given(PLAIN)
def test_it_agrees_with_the_reader_of_the_library(node: object) -> None:
    data = yaml.safe_dump(node).encode()
    assert list(read_yaml(data)) == list(yaml.load_all(data, Loader=yaml.BaseLoader))


@given(st.binary(max_size=200))
def test_any_bytes_give_documents_or_one_error(data: bytes) -> None:
    with suppress(TrajectoryError):
        list(read_yaml(data))
