"""Files that are there only if something was written."""

from __future__ import annotations

from pathlib import Path

import pytest

from bcapscope.player.control_log import open_new_file

pytestmark = pytest.mark.lifecycle


@pytest.mark.parametrize("data", [b"", b"something"])
def test_a_file_to_which_nothing_was_written_goes(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "file"
    with open_new_file(str(path)) as file:
        assert file is not None
        assert path.exists()
        file.write(data)
    assert path.exists() is bool(data)


def test_a_file_is_never_written_over(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"mine")
    with pytest.raises(FileExistsError), open_new_file(str(path)):
        pass
    assert path.read_bytes() == b"mine"


def test_no_path_is_no_file() -> None:
    with open_new_file(None) as file:
        assert file is None


def test_a_file_that_somebody_else_removes_is_gone_already(tmp_path: Path) -> None:
    path = tmp_path / "file"
    with open_new_file(str(path)):
        path.unlink()
    assert not path.exists()
