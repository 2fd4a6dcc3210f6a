"""Records on disk, read while they are written."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest

from bcapscope.capture.append_log import AppendLogReader, AppendLogWriter, CachedFileReader


def test_nothing_is_there_before_flush(tmp_path: Path) -> None:
    appender = AppendLogWriter(tmp_path / "a")
    with closing(AppendLogReader(tmp_path / "a")) as records:
        appender.add(b"one")
        assert (appender.count, records.refresh()) == (1, 0)
        with pytest.raises(IndexError):
            records.read_record(0)
        appender.flush()
        assert records.refresh() == 1
        appender.add(b"four")
        appender.flush()
        appender.flush()
        assert records.refresh() == len(records) == 2
        assert [records.read_record(number) for number in range(2)] == [b"one", b"four"]
    appender.close()


@pytest.mark.parametrize("number", [-1, 1, 2**40])
def test_records_that_are_not_there(tmp_path: Path, number: int) -> None:
    appender = AppendLogWriter(tmp_path / "a")
    appender.add(b"one")
    appender.flush()
    with closing(AppendLogReader(tmp_path / "a")) as records, pytest.raises(IndexError):
        records.read_record(number)
    appender.close()


def test_a_second_appender_does_not_write_over_the_first(tmp_path: Path) -> None:
    AppendLogWriter(tmp_path / "a").close()
    with pytest.raises(FileExistsError):
        AppendLogWriter(tmp_path / "a")


def test_window_reads_anywhere_and_what_was_added_later(tmp_path: Path) -> None:
    path = tmp_path / "a"
    data = bytes(range(256)) * 1024
    path.write_bytes(data)
    window = CachedFileReader(path)
    for start, size in ((0, 10), (100_000, 7), (5, 3), (262_000, 200), (0, 200_000), (262_100, 44)):
        assert window.read(start, size) == data[start : start + size]
    assert window.read(262_140, 10) == data[-4:]
    with path.open("ab") as file:
        file.write(b"more")
    assert window.read(262_140, 10) == data[-4:] + b"more"
    window.close()


def test_window_that_is_to_forget_sees_what_was_changed(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"before")
    window = CachedFileReader(path)
    assert window.read(0, 6) == b"before"
    path.write_bytes(b"behind")
    assert window.read(0, 6) == b"before"
    window.discard_cache()
    assert window.read(0, 6) == b"behind"
    window.close()
