"""What the relay writes is what the watcher reads, in order, or is counted."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.proxy.ring_buffer import (
    BATCH_SIZE,
    DELAY_FIGURES,
    MAX_WAITING_NOTICES,
    RING_OVERHEAD,
    RelayCounter,
    RingReader,
    RingRecord,
    RingRecordKind,
    RingWriter,
    hole_sizes,
)


def ends(size: int) -> tuple[RingWriter, RingReader]:
    memory = memoryview(bytearray(RING_OVERHEAD + size))
    return RingWriter(memory), RingReader(memory)


def everything(reader: RingReader) -> list[RingRecord]:
    return [*reader.read_records(), *reader.read_records()]


_RECORDS = st.tuples(
    st.booleans(),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**63 - 1),
    st.integers(0, 2**63 - 1),
    st.binary(max_size=300),
    st.binary(max_size=20),
)


@given(st.lists(_RECORDS, max_size=60), st.integers(1, 9))
def test_whatever_goes_in_comes_out(
    records: list[tuple[bool, int, int, int, bytes, bytes]], every: int
) -> None:
    writer, reader = ends(1 << 12)
    found: list[RingRecord] = []
    for number, (up, client, came, left, data, note) in enumerate(records):
        assert writer.write_record(up, client, came, left, data, note=note)
        if number % every == 0:
            found += everything(reader)
    found += everything(reader)
    assert found == [RingRecord(RingRecordKind.DATA, *record) for record in records]


def test_a_look_shows_what_was_there_at_the_look_before() -> None:
    writer, reader = ends(1 << 12)
    writer.write_record(True, 1, 2, 3, b"a")
    assert reader.read_records() == []
    writer.write_record(True, 1, 2, 3, b"b")
    assert [record.data for record in reader.read_records()] == [b"a"]
    assert [record.data for record in reader.read_records()] == [b"b"]
    assert not reader.bytes_waiting


def test_what_finds_no_room_is_counted_and_the_rest_is_whole() -> None:
    writer, reader = ends(1 << 10)
    room = sum(writer.write_record(True, 1, 2, 3, bytes(100)) for _ in range(20))
    assert 0 < room < 20
    assert writer.counts[RelayCounter.UNWATCHED] == reader.counts[RelayCounter.UNWATCHED] == 20 - room
    assert len(everything(reader)) == room
    assert writer.write_record(True, 1, 2, 3, b"again")
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
    records: list[RingRecord] = []
    sent: dict[tuple[int, bool, bool], int] = {}
    for time, (client, up, came, left, size, looks) in enumerate(said, 1):
        writer.write_record(up, client, time if came else 0, time if left else 0, bytes(size))
        for leg, has in ((False, came), (True, left)):
            sent[client, up, leg] = sent.get((client, up, leg), 0) + (size if has else 0)
        if looks:
            records += everything(reader)
    records += everything(reader)
    for client in (1, 2, 3):
        for up in (True, False):
            writer.write_record(up, client, 999, 999, b"")  # whatever follows tells what is missing before it
            records += everything(reader)
    found: dict[tuple[int, bool, bool], int] = {}
    for record in records:
        sizes = hole_sizes(record) if record.kind is RingRecordKind.HOLE else (len(record.data),) * 2
        for leg, time, size in zip((False, True), (record.received_at, record.sent_at), sizes, strict=True):
            way = record.client, record.up, leg
            found[way] = found.get(way, 0) + (size if time else 0)
    assert all(record.client != 3 for record in records if record.kind is RingRecordKind.HOLE)
    assert all(found.get(way, 0) == size for way, size in sent.items() if way[0] != 3)


def test_a_client_that_is_met_late_has_its_hole_behind_that() -> None:
    writer, reader = ends(1 << 10)
    while writer.write_record(True, 1, 2, 3, bytes(50)):
        pass
    writer.streams.add(7)
    writer.write_required(RingRecordKind.CLIENT_OPENED, 7, b"who", 5)
    writer.write_record(True, 7, 20, 21, bytes(200))
    found = everything(reader)
    writer.write_record(True, 7, 30, 31, b"x")
    found += everything(reader)
    assert [each.kind for each in found if each.client == 7] == [
        RingRecordKind.CLIENT_OPENED,
        RingRecordKind.HOLE,
        RingRecordKind.DATA,
    ]


def test_a_client_that_came_and_went_unseen_leaves_nothing() -> None:
    writer, reader = ends(1 << 10)
    while writer.write_record(True, 1, 2, 3, b""):
        pass
    for client in (7, 8):
        writer.streams.add(client)
        writer.write_required(RingRecordKind.CLIENT_OPENED, client, b"who", 5)
        writer.write_record(True, client, 20, 21, bytes(200))
    writer.write_required(RingRecordKind.CLIENT_CLOSED, 7, b"", 30)
    found = everything(reader)
    for client in (7, 8):
        writer.write_record(True, client, 30, 31, b"x")
    found += everything(reader)
    assert [each.kind for each in found if each.client == 7] == [RingRecordKind.DATA]
    assert [each.kind for each in found if each.client == 8] == [
        RingRecordKind.CLIENT_OPENED,
        RingRecordKind.HOLE,
        RingRecordKind.DATA,
    ]


def test_a_hole_in_a_stream_stands_before_its_end() -> None:
    writer, reader = ends(1 << 10)
    writer.streams.add(7)
    while writer.write_record(True, 7, 2, 3, bytes(50)):
        pass
    writer.write_required(RingRecordKind.END, 7, b"", 9, up=True)
    writer.write_required(RingRecordKind.CLIENT_CLOSED, 7, b"", 9)
    found = everything(reader)
    writer.write_record(True, 1, 2, 3, b"")
    found += everything(reader)
    *_, last, hole, end, gone = (record for record in found if record.client == 7)
    assert [each.kind for each in (last, hole, end, gone)] == [
        RingRecordKind.DATA,
        RingRecordKind.HOLE,
        RingRecordKind.END,
        RingRecordKind.CLIENT_CLOSED,
    ]
    assert hole_sizes(hole) == (50, 50)
    assert (hole.received_at, hole.sent_at) == (2, 3)


def test_a_hole_is_written_only_together_with_the_next_record() -> None:
    writer, reader = ends(1 << 10)
    writer.streams.add(7)
    while writer.write_record(True, 7, 2, 3, bytes(50)):
        pass
    everything(reader)
    while writer.write_record(True, 1, 2, 3, bytes(400)):
        pass
    assert not writer.write_record(True, 7, 4, 5, bytes(100))  # there is room for the hole alone
    found = everything(reader)
    assert {each.client for each in found} == {1}
    assert writer.write_record(True, 7, 6, 7, b"x")
    hole, data = everything(reader)
    assert (hole.kind, hole_sizes(hole)) == (RingRecordKind.HOLE, (150, 150))
    assert data.data == b"x"


def test_a_hole_counts_only_bytes_that_were_received_or_sent() -> None:
    writer, reader = ends(1 << 10)
    writer.streams.add(7)
    while writer.write_record(True, 7, 2, 3, bytes(50)):
        pass
    assert not writer.write_record(True, 7, 0, 4, bytes(60))
    assert not writer.write_record(True, 7, 5, 0, bytes(70))
    everything(reader)
    writer.write_record(True, 7, 8, 9, b"")
    hole, data = everything(reader)
    assert (hole.kind, data.kind) == (RingRecordKind.HOLE, RingRecordKind.DATA)
    assert hole_sizes(hole) == (50 + 70, 50 + 60)
    assert (hole.received_at, hole.sent_at) == (5, 4)


def test_what_must_be_known_comes_before_what_follows() -> None:
    writer, reader = ends(1 << 10)
    while writer.write_record(True, 1, 2, 3, b""):
        pass
    writer.write_required(RingRecordKind.CLIENT_OPENED, 7, b"who", 5)
    assert not writer.write_record(True, 7, 2, 3, b"small, but not before that")
    everything(reader)
    assert writer.write_record(True, 7, 2, 3, b"now")
    assert [record.data for record in everything(reader)] == [b"who", b"now"]


def test_notes_are_written_together_before_anything_else_and_counted() -> None:
    writer, reader = ends(1 << 12)
    for number in range(BATCH_SIZE):
        writer.pending_datagrams.append((number % 2 == 0, 1, [], number and 5, bytes(number)))
    writer.write_required(RingRecordKind.NOTICE, 0, b"after", 9)
    found = everything(reader)
    assert [record.data for record in found] == [*(bytes(number) for number in range(BATCH_SIZE)), b"after"]
    assert [record.sent_at for record in found[:3]] == [0, 5, 5]
    counts = writer.counts
    assert (counts[RelayCounter.CAME_UP], counts[RelayCounter.LEFT_UP]) == (8, 7)
    assert (counts[RelayCounter.CAME_DOWN], counts[RelayCounter.LEFT_DOWN]) == (8, 8)


def test_a_batch_that_does_not_fit_at_once_is_written_one_by_one() -> None:
    writer, reader = ends(1 << 10)
    found: list[RingRecord] = []
    for number in range(40):
        writer.pending_datagrams.append((True, number, [], 5, bytes(90)))
        if len(writer.pending_datagrams) == 5:
            writer.flush()
            found += everything(reader)
    assert [record.client for record in found] == list(range(40))
    assert writer.counts[RelayCounter.CAME_UP] == 40


def test_without_a_reader_nothing_piles_up() -> None:
    writer, _ = ends(1 << 10)
    writer.detach_reader()
    for _ in range(100):
        writer.write_required(RingRecordKind.NOTICE, 0, bytes(50), 1)
        writer.write_record(True, 1, 2, 3, bytes(100))
    assert writer.counts[RelayCounter.UNWATCHED] > 80


def test_the_watcher_leaves_figures_for_the_relay_and_records_do_not_touch_them() -> None:
    writer, reader = ends(1 << 12)
    for figure in range(DELAY_FIGURES):
        reader.figures[figure] = 1000 + figure
    for number in range(200):
        writer.write_record(True, 1, 2, number + 1, bytes(100))
        everything(reader)
    assert list(writer.figures) == [1000 + figure for figure in range(DELAY_FIGURES)]
    assert max(writer.counts) == 0


def test_a_reader_ahead_makes_no_room_and_the_one_behind_goes_no_further() -> None:
    memory = memoryview(bytearray(RING_OVERHEAD + (1 << 10)))
    writer, behind, ahead = RingWriter(memory), RingReader(memory), RingReader(memory, ahead=True)
    written = sum(writer.write_record(True, 1, 2, number, bytes(100)) for number in range(20))
    assert len(everything(ahead)) == written
    assert not writer.write_record(True, 1, 2, 3, bytes(100))
    assert behind.read_records(2, until=0) == []
    assert len(behind.read_records(2, until=ahead.position)) == 2
    assert writer.write_record(True, 1, 2, 77, bytes(100))
    assert [record.sent_at for record in behind.read_records(until=ahead.position)] == list(range(2, written))
    assert [record.sent_at for record in everything(ahead)] == [77]
    assert [record.sent_at for record in behind.read_records(until=ahead.position)] == [77]


def test_what_must_be_known_is_bounded_where_the_reader_stands_still() -> None:
    writer, reader = ends(1 << 10)
    writer.write_required(RingRecordKind.CLIENT_OPENED, 1, b"here", 1)
    while writer.write_record(True, 1, 2, 3, b""):
        pass
    before = writer.counts[RelayCounter.UNWATCHED]
    for client in range(2, 5000):
        writer.write_required(RingRecordKind.CLIENT_OPENED, client, b"comes and goes", 1)
        writer.write_required(RingRecordKind.END, client, b"", 1)
        writer.write_required(RingRecordKind.CLIENT_CLOSED, client, b"", 1)
        writer.write_required(RingRecordKind.NOTICE, 0, b"something", 1)
    writer.write_required(RingRecordKind.CLIENT_CLOSED, 1, b"", 1)
    assert writer.counts[RelayCounter.UNWATCHED] > before
    found: list[RingRecord] = []
    for _ in range(200):
        found += everything(reader)
        writer.write_record(True, 1, 2, 3, b"")
    kinds = [record.kind for record in found if record.kind is not RingRecordKind.DATA]
    assert kinds.count(RingRecordKind.NOTICE) == MAX_WAITING_NOTICES
    assert kinds.count(RingRecordKind.CLIENT_OPENED) == kinds.count(RingRecordKind.CLIENT_CLOSED) == 1


def test_a_ring_is_filled_to_its_last_byte() -> None:
    writer, reader = ends(1 << 10)
    assert (reader.fill_ratio, reader.bytes_waiting, writer.bytes_read) == (0.0, 0, 0)
    assert [writer.write_record(True, 1, 2, 3, bytes(89), note=b"1234567") for _ in range(9)] == [
        True
    ] * 8 + [False]
    assert (reader.fill_ratio, reader.bytes_waiting, writer.bytes_written) == (1.0, 1024, 1024)
    assert reader.read_records() == []
    assert len(reader.read_records(2)) == 2
    assert (reader.fill_ratio, reader.bytes_waiting, writer.bytes_read) == (0.75, 768, 256)


def test_a_writer_knows_how_far_the_faster_reader_is() -> None:
    memory = memoryview(bytearray(RING_OVERHEAD + (1 << 10)))
    writer, behind, ahead = RingWriter(memory), RingReader(memory), RingReader(memory, ahead=True)
    for _ in range(4):
        writer.write_record(True, 1, 2, 3, bytes(96))
    everything(ahead)
    assert writer.bytes_read == 512
    assert behind.read_records(until=512)
    assert writer.bytes_read == 512


def test_the_largest_record_fits_into_the_margin() -> None:
    writer, reader = ends(1 << 18)
    largest = (1 << 17) - 4096 - 32
    assert not writer.write_record(True, 1, 2, 3, bytes(largest + 1))
    for _ in range(5):  # somewhere, one begins before the end of the ring, and ends behind it
        data = bytes(largest - 1) + b"x"
        assert writer.write_record(True, 1, 2, 3, data)
        assert [record.data for record in everything(reader)] == [data]


def test_how_urgent_reading_is_can_be_seen_at_both_ends() -> None:
    writer, reader = ends(1 << 10)
    assert reader.urgency == 0
    writer.urgency = 2
    assert (reader.urgency, max(writer.counts), max(writer.figures)) == (2, 0, 0)


def test_waiting_datagrams_are_written_before_a_record() -> None:
    writer, reader = ends(1 << 12)
    writer.pending_datagrams.append((True, 1, [], 5, b"first"))
    writer.write_record(True, 1, 2, 3, b"second")
    assert [record.data for record in everything(reader)] == [b"first", b"second"]


def test_notices_beyond_the_limit_are_counted_and_what_must_be_known_is_not_lost() -> None:
    writer, reader = ends(1 << 10)
    while writer.write_record(True, 1, 2, 3, b""):
        pass
    before = writer.counts[RelayCounter.UNWATCHED]
    for _ in range(1024 + 5):
        writer.write_required(RingRecordKind.NOTICE, 0, b"something", 1)
    assert writer.counts[RelayCounter.UNWATCHED] == before + 5
    for client in (7, 8):
        writer.write_required(RingRecordKind.CLIENT_OPENED, client, b"who", 5)
    writer.write_required(RingRecordKind.END, 7, b"", 6)
    writer.write_required(RingRecordKind.CLIENT_CLOSED, 7, b"", 6)
    assert writer.counts[RelayCounter.UNWATCHED] == before + 5 + 2
    found: list[RingRecord] = []
    for _ in range(200):
        found += everything(reader)
        writer.write_record(True, 1, 2, 3, b"")
    assert [record.client for record in found if record.kind is RingRecordKind.CLIENT_OPENED] == [8]


def test_the_memory_can_be_closed_once_it_is_released() -> None:
    memory = bytearray(RING_OVERHEAD + 1024)
    writer = RingWriter(memoryview(memory))
    writer.release()
    memory.clear()
