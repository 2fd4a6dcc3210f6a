"""Saved requests."""

from __future__ import annotations

from pathlib import Path

import pytest

from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.tui.controller_access.saved_requests import (
    MAX_FILE_SIZE,
    SavedRequestError,
    list_requests,
    load_request,
    save_request,
)

HANDLE = Variant(VT.I4, 5)
MODE = (HANDLE, Variant(VT.BSTR, "slvChangeMode"), Variant(VT.I4, 2))


def test_a_request_is_a_small_file_that_people_can_read(tmp_path: Path) -> None:
    path = save_request(tmp_path / "new", "Slave mode J", 64, MODE, "joints")
    assert path.name == "Slave mode J.yaml"
    assert path.read_text() == (
        "function: Robot_Execute\narguments:\n- slvChangeMode\n- i4:2\nnote: joints\n"
    )
    found = load_request(path)
    assert (found.name, found.function.id, found.values, found.note) == (
        "Slave mode J",
        64,
        MODE[1:],
        "joints",
    )


def test_numbers_may_stand_bare(tmp_path: Path) -> None:
    path = tmp_path / "speed.yaml"
    path.write_text("function: robot_speed\narguments: [-1, 50.5]\n")
    assert load_request(path).values == (Variant(VT.I4, -1), Variant(VT.R4, 50.5))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("function: Robot_Exec\n", "no function 'Robot_Exec'"),
        ("function: Robot_Speed\narguments: [1]\n", "expected: lAxis, fSpeed"),
        ("function: Robot_Speed\narguments: [x, 1]\n", "lAxis: 'x' is not a VT_I4"),
        ("function: Robot_Speed\nspeed: 3\n", "speed"),
        ("- 1\n", "array"),
        ("{", "yaml"),
        ("a: &a [*a, *a]\n", "yaml"),
        ("x" * (MAX_FILE_SIZE + 1), "larger than"),
    ],
)
def test_what_is_no_request_is_told(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(SavedRequestError, match=reason):
        load_request(path)
    ((name, found),) = list_requests(tmp_path)
    assert name == "bad"
    assert isinstance(found, str)


def test_no_nesting_is_too_deep_to_be_refused(tmp_path: Path) -> None:
    path = tmp_path / "deep.yaml"
    path.write_text("[" * (MAX_FILE_SIZE - 1))
    with pytest.raises(SavedRequestError, match=r"deep\.yaml: line 1: more than 64 levels"):
        load_request(path)


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_bytes(b"function: \xff\xfe\n")
    assert isinstance(list_requests(tmp_path)[0][1], str)


def test_what_cannot_be_written_down(tmp_path: Path) -> None:
    nested = Variant.array(VT.VARIANT, (Variant.array(VT.VARIANT, (EMPTY, EMPTY)),))
    with pytest.raises(SavedRequestError, match="VARIANT array"):
        save_request(tmp_path, "x", 64, (*MODE[:2], nested))
    with pytest.raises(SavedRequestError, match="half a character"):
        save_request(tmp_path, "x", 64, (MODE[0], Variant(VT.BSTR, "\ud800"), EMPTY))
    with pytest.raises(SavedRequestError, match="known functions"):
        save_request(tmp_path, "x", 200, ())
    with pytest.raises(SavedRequestError, match="the name is missing"):
        save_request(tmp_path, " .", 64, MODE)


def test_a_name_cannot_leave_the_folder(tmp_path: Path) -> None:
    path = save_request(tmp_path / "requests", "../../x\x1b[31m/y", 64, MODE)
    assert path.parent == tmp_path / "requests"
    assert "\x1b" not in path.name


def test_no_folder_is_no_requests(tmp_path: Path) -> None:
    assert list_requests(tmp_path / "none") == []
    (tmp_path / "file").write_text("")
    with pytest.raises(SavedRequestError, match="file"):
        save_request(tmp_path / "file", "x", 64, MODE)
