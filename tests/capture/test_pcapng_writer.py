"""Packets written as pcapng, with notes."""

from __future__ import annotations

import gzip
import subprocess
from io import BytesIO
from pathlib import Path
from shutil import which

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.capture.capture_file import CaptureFile, open_capture
from bcapscope.capture.packet import Interface, Packet
from bcapscope.capture.pcapng_writer import MARK_COMMENT, PcapngWriter, write_annotated
from bcapscope.errors import CaptureError
from tests.cli.run import CAPTURES

TIME = 1_700_000_000_123_456_789
LAN, RAW = Interface(1, "lan 日本"), Interface(101)


def read(data: bytes) -> list[Packet]:
    return list(CaptureFile(BytesIO(data)))


def written(packets: list[Packet]) -> bytes:
    file = BytesIO()
    writer = PcapngWriter(file)
    for packet in packets:
        writer.write(packet)
    return file.getvalue()


@given(
    st.lists(
        st.tuples(
            st.integers(0, 2**63),
            st.binary(max_size=40),
            st.integers(0, 2**32 - 1),
            st.sampled_from([LAN, RAW, Interface(113, "any")]),
            st.lists(st.text(st.characters(exclude_categories=["Cs"]), min_size=1)).map(tuple),
        )
    )
)
def test_what_is_written_is_read(packets: list[Packet]) -> None:
    packets = [(time, data, max(size, len(data)), *rest) for time, data, size, *rest in packets]  # type: ignore[misc]
    assert read(written(packets)) == packets


@given(
    st.integers(0, 2**64 - 1),
    st.integers(0, 2**64 - 1),
    st.tuples(st.binary(max_size=40), st.binary(max_size=40)),
    st.binary(max_size=40),
)
def test_two_packets_made_at_once_are_those_made_one_by_one(
    time: int, later: int, heads: tuple[bytes, bytes], data: bytes
) -> None:
    file = BytesIO()
    writer = PcapngWriter(file)
    make = writer.pair_encoder((LAN, heads[0]), (RAW, heads[1]), len(data))
    writer.write_blocks(make(time, later, data), 2)
    one_by_one: list[Packet] = []
    for when, head, where in zip((time, later), heads, (LAN, RAW), strict=True):
        whole = head + data
        one_by_one.append((when, whole, len(whole), where, ()))
    assert read(file.getvalue()) == read(written(one_by_one))


def test_a_long_note_is_cut_between_characters() -> None:
    ((*_, comments),) = read(written([(TIME, b"", 0, RAW, ("軸" * 30_000,))]))
    assert comments == ("軸" * (65535 // 3),)


def test_lone_surrogates_are_replaced() -> None:
    ((*_, comments),) = read(written([(TIME, b"", 0, RAW, ("a\ud800b",))]))
    assert comments == ("a?b",)


@pytest.mark.parametrize("path", sorted(CAPTURES.glob("*.pcap*")), ids=lambda path: path.name)
def test_notes_come_on_top_of_comments_and_nothing_else_changes(path: Path) -> None:
    with open_capture(path) as capture:
        before = list(capture)
    file = BytesIO()
    notes = {1: "look", len(before): ""}
    assert write_annotated(before, notes, file) == len(before)
    after = read(file.getvalue())
    assert [packet[:4] for packet in after] == [packet[:4] for packet in before]
    for number, (old, new) in enumerate(zip(before, after, strict=True), 1):
        note = (notes[number] or MARK_COMMENT,) if number in notes else ()
        assert new[4] == (*old[4], *note)


def test_damage_is_told_after_all_before_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "cut.pcapng.gz"
    path.write_bytes(gzip.compress((CAPTURES / "retry-story.pcapng").read_bytes()[:-20]))
    file = BytesIO()
    with pytest.raises(CaptureError), open_capture(path) as capture:
        write_annotated(capture, {}, file)
    assert len(read(file.getvalue())) == 5


@pytest.mark.skipif(which("tshark") is None, reason="tshark is not installed")
def test_tshark_reads_notes(tmp_path: Path) -> None:
    path = tmp_path / "a.pcapng"
    with path.open("wb") as file, open_capture(CAPTURES / "retry-story.pcapng") as capture:
        write_annotated(capture, {2: "see here: 軸"}, file)
    argv = ["tshark", "-r", str(path), "-Y", "frame.number == 2", "-T", "fields", "-e", "frame.comment"]
    done = subprocess.run(argv, capture_output=True, check=True, text=True)
    assert "see here: 軸" in done.stdout
