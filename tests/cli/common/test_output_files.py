"""Files that appear when they are complete, and not at all when something fails."""

from __future__ import annotations

from pathlib import Path

import pytest

from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.cli.common.output_files import AtomicFile, check_output_path
from bcapscope.errors import FileWriteError
from tests.cli.run import CAPTURES, run, run_here

pytestmark = pytest.mark.lifecycle


def test_a_file_has_its_name_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    with AtomicFile(path) as file:
        file.write(b"one")
        assert not path.exists()
        file.write(b" two")
        file.commit()
    assert [each.name for each in tmp_path.iterdir()] == ["a.csv"]
    assert path.read_bytes() == b"one two"


def test_what_is_not_kept_leaves_nothing(tmp_path: Path) -> None:
    with AtomicFile(tmp_path / "a.csv") as file:
        file.write(b"one")
        assert len(list(tmp_path.iterdir())) == 1
    assert list(tmp_path.iterdir()) == []


def test_what_came_meanwhile_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    with AtomicFile(path) as file:
        file.write(b"one")
        path.write_bytes(b"mine")
        with pytest.raises(FileWriteError, match="exists already"):
            file.commit()
    assert [each.read_bytes() for each in tmp_path.iterdir()] == [b"mine"]


def test_another_name_may_be_given_at_the_end(tmp_path: Path) -> None:
    with AtomicFile(tmp_path / "a-1.csv") as file:
        file.write(b"one")
        file.commit(tmp_path / "a.csv")
    assert [each.name for each in tmp_path.iterdir()] == ["a.csv"]


def test_what_is_no_file_is_never_replaced(tmp_path: Path) -> None:
    with pytest.raises(FileWriteError, match="not a regular file"):
        check_output_path(tmp_path, overwrite=True)
    with pytest.raises(FileWriteError, match="not a regular file"):
        check_output_path(Path("/dev/null"), overwrite=True)


def test_the_error_names_the_path_and_the_reason(tmp_path: Path) -> None:
    def refused(path: Path) -> str:
        check_output_path(path)
        with pytest.raises(FileWriteError) as caught, AtomicFile(path) as file:
            file.write(b"one")
        assert caught.value.path == path
        return str(caught.value)

    assert refused(tmp_path / "nowhere" / "a.csv").endswith("no such file or directory")
    assert refused(tmp_path / ("a" * 300)).endswith("name too long")


def test_a_command_that_cannot_write_exits_with_the_code_and_a_harmless_message(tmp_path: Path) -> None:
    path = tmp_path / "a\x1b.csv"
    path.write_bytes(b"mine")
    for run_program in (run, run_here):
        ran = run_program("extract", CAPTURES / "slave-session.pcapng", "-o", path)
        assert ran.code == ExitCode.UNWRITABLE
        assert ran.err.endswith("a\\x1b.csv: exists already. Add --force to overwrite it\n")
