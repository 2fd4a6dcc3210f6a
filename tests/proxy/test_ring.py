"""What the relay writes is what the watcher reads, in order, or is counted."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.proxy.ring import (
    BATCH,
    HEADER,
    MOST_TOLD,
    Count,
    Figure,
    Kind,
    Record,
    RingReader,
    RingWriter,
    unseen,
)


def ends(size: int) -> tuple[RingWriter, RingReader]:
    memory = memoryview(bytearray(HEADER + size))
    return RingWriter(memory), RingReader(memory)


def everything(reader: RingReader) -> list[Record]:
    return [*reader.take(), *reader.take()]


_RECORDS = st.tuples(
    st.booleans(),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**63 - 1),
    st.integers(0, 2**63 - 1),
    st.binary(max_size=300),
    st.text(max_size=20).filter(lambda text: text.isprintable()),
)


@given(st.lists(_RECORDS, max_size=60), st.integers(1, 9))
def test_whatever_goes_in_comes_out(
    records: list[tuple[bool, int, int, int, bytes, str]], every: int
) -> None:
    writer, reader = ends(1 << 12)
    found: list[Record] = []
    for number, (up, client, came, left, data, note) in enumerate(records):
        assert writer.put(up, client, came, left, data, note=note.encode())
        if number % every == 0:
            found += everything(reader)
    found += everything(reader)
    assert found == [Record(Kind.DATA, *record) for record in records]


def test_a_look_shows_what_was_there_at_the_look_before() -> None:
    writer, reader = ends(1 << 12)
    writer.put(True, 1, 2, 3, b"a")
    assert reader.take() == []
    writer.put(True, 1, 2, 3, b"b")
    assert [record.data for record in reader.take()] == [b"a"]
    assert [record.data for record in reader.take()] == [b"b"]
    assert not reader.waiting


def test_what_finds_no_room_is_counted_and_the_rest_is_whole() -> None:
    writer, reader = ends(1 << 10)
    room = sum(writer.put(True, 1, 2, 3, bytes(100)) for _ in range(20))
    assert 0 < room < 20
    assert writer.counts[Count.UNWATCHED] == reader.counts[Count.UNWATCHED] == 20 - room
    assert len(everything(reader)) == room
    assert writer.put(True, 1, 2, 3, b"again")
    assert everything(reader)[-1].data == b"again"


@given(
    st.lists(
        st.tuples(
            st.integers(1, 3), st.booleans(), st.booleans(), st.booleans(), st.integers(0, 90), st.booleans()
        ),
        max_size=80,
    )
)
def test_of_a_stream_each_byte_is_there_or_its_place_is_told(
    said: list[tuple[int, bool, bool, bool, int, bool]],
) -> None:
    writer, reader = ends(1 << 10)
    writer.streams |= {1, 2}  # and 3 sends datagrams
    records: list[Record] = []
    sent: dict[tuple[int, bool, bool], int] = {}
    for time, (client, up, came, left, size, looks) in enumerate(said, 1):
        writer.put(up, client, time if came else 0, time if left else 0, bytes(size))
        for leg, has in ((False, came), (True, left)):
            sent[client, up, leg] = sent.get((client, up, leg), 0) + (size if has else 0)
        if looks:
            records += everything(reader)
    records += everything(reader)
    for client in (1, 2, 3):
        for up in (True, False):
            writer.put(up, client, 999, 999, b"")  # whatever follows tells what is missing before it
            records += everything(reader)
    found: dict[tuple[int, bool, bool], int] = {}
    for record in records:
        sizes = unseen(record) if record.kind is Kind.HOLE else (len(record.data),) * 2
        for leg, time, size in zip((False, True), (record.came, record.left), sizes, strict=True):
            way = record.client, record.up, leg
            found[way] = found.get(way, 0) + (size if time else 0)
    assert all(record.client != 3 for record in records if record.kind is Kind.HOLE)
    assert all(found.get(way, 0) == size for way, size in sent.items() if way[0] != 3)


def test_a_client_that_is_met_late_has_its_hole_behind_that() -> None:
    writer, reader = ends(1 << 10)
    while writer.put(True, 1, 2, 3, bytes(50)):
        pass
    writer.streams.add(7)
    writer.must(Kind.OPENED, 7, b"who", 5)
    writer.put(True, 7, 20, 21, bytes(200))
    found = everything(reader)
    writer.put(True, 7, 30, 31, b"x")
    found += everything(reader)
    assert [each.kind for each in found if each.client == 7] == [Kind.OPENED, Kind.HOLE, Kind.DATA]


def test_a_hole_in_a_stream_stands_before_its_end() -> None:
    writer, reader = ends(1 << 10)
    writer.streams.add(7)
    while writer.put(True, 7, 2, 3, bytes(50)):
        pass
    writer.must(Kind.END, 7, b"", 9, up=True)
    writer.must(Kind.GONE, 7, b"", 9)
    found = everything(reader)
    writer.put(True, 1, 2, 3, b"")
    found += everything(reader)
    *_, last, hole, end, gone = (record for record in found if record.client == 7)
    assert [each.kind for each in (last, hole, end, gone)] == [Kind.DATA, Kind.HOLE, Kind.END, Kind.GONE]
    assert unseen(hole) == (50, 50)
    assert (hole.came, hole.left) == (2, 3)


def test_what_must_be_known_comes_before_what_follows() -> None:
    writer, reader = ends(1 << 10)
    while writer.put(True, 1, 2, 3, b""):
        pass
    writer.must(Kind.OPENED, 7, b"who", 5)
    assert not writer.put(True, 7, 2, 3, b"small, but not before that")
    everything(reader)
    assert writer.put(True, 7, 2, 3, b"now")
    assert [record.data for record in everything(reader)] == [b"who", b"now"]


def test_notes_are_written_together_before_anything_else_and_counted() -> None:
    writer, reader = ends(1 << 12)
    for number in range(BATCH):
        writer.notes.append((number % 2 == 0, 1, [], number and 5, bytes(number)))
    writer.must(Kind.TOLD, 0, b"after", 9)
    found = everything(reader)
    assert [record.data for record in found] == [*(bytes(number) for number in range(BATCH)), b"after"]
    assert [record.left for record in found[:3]] == [0, 5, 5]
    counts = writer.counts
    assert (counts[Count.CAME_UP], counts[Count.LEFT_UP]) == (8, 7)
    assert (counts[Count.CAME_DOWN], counts[Count.LEFT_DOWN]) == (8, 8)


def test_a_batch_that_does_not_fit_at_once_is_written_one_by_one() -> None:
    writer, reader = ends(1 << 10)
    found: list[Record] = []
    for number in range(40):
        writer.notes.append((True, number, [], 5, bytes(90)))
        if len(writer.notes) == 5:
            writer.flush()
            found += everything(reader)
    assert [record.client for record in found] == list(range(40))
    assert writer.counts[Count.CAME_UP] == 40


def test_without_a_reader_nothing_piles_up() -> None:
    writer, _ = ends(1 << 10)
    writer.abandon()
    for _ in range(100):
        writer.must(Kind.TOLD, 0, bytes(50), 1)
        writer.put(True, 1, 2, 3, bytes(100))
    assert writer.counts[Count.UNWATCHED] > 80


def test_the_watcher_leaves_figures_for_the_relay_and_records_do_not_touch_them() -> None:
    writer, reader = ends(1 << 12)
    for figure in Figure:
        reader.figures[figure] = 1000 + figure
    for number in range(200):
        writer.put(True, 1, 2, number + 1, bytes(100))
        everything(reader)
    assert [writer.figures[figure] for figure in Figure] == [1000 + figure for figure in Figure]
    assert max(writer.counts) == 0


def test_a_reader_ahead_makes_no_room_and_the_one_behind_goes_no_further() -> None:
    memory = memoryview(bytearray(HEADER + (1 << 10)))
    writer, behind, ahead = RingWriter(memory), RingReader(memory), RingReader(memory, ahead=True)
    written = sum(writer.put(True, 1, 2, number, bytes(100)) for number in range(20))
    assert len(everything(ahead)) == written
    assert not writer.put(True, 1, 2, 3, bytes(100))
    assert behind.take(2, until=0) == []
    assert len(behind.take(2, until=ahead.place)) == 2
    assert writer.put(True, 1, 2, 77, bytes(100))
    assert [record.left for record in behind.take(until=ahead.place)] == list(range(2, written))
    assert [record.left for record in everything(ahead)] == [77]
    assert [record.left for record in behind.take(until=ahead.place)] == [77]


def test_what_must_be_known_is_bounded_where_the_reader_stands_still() -> None:
    writer, reader = ends(1 << 10)
    writer.must(Kind.OPENED, 1, b"here", 1)
    while writer.put(True, 1, 2, 3, b""):
        pass
    before = writer.counts[Count.UNWATCHED]
    for client in range(2, 5000):
        writer.must(Kind.OPENED, client, b"comes and goes", 1)
        writer.must(Kind.END, client, b"", 1)
        writer.must(Kind.GONE, client, b"", 1)
        writer.must(Kind.TOLD, 0, b"something", 1)
    writer.must(Kind.GONE, 1, b"", 1)
    assert writer.counts[Count.UNWATCHED] > before
    found: list[Record] = []
    for _ in range(200):
        found += everything(reader)
        writer.put(True, 1, 2, 3, b"")
    kinds = [record.kind for record in found if record.kind is not Kind.DATA]
    assert kinds.count(Kind.TOLD) == MOST_TOLD
    assert kinds.count(Kind.OPENED) == kinds.count(Kind.GONE) == 1
