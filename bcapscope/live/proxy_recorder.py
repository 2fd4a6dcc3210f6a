"""Records both legs of a proxy's traffic. Each leg has its own interface in the capture."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from operator import itemgetter
from typing import TypeAlias

from bcapscope.capture.packet import Interface
from bcapscope.capture.pcapng_writer import PacketPairEncoder
from bcapscope.capture.socket_recording import RAW_IP, Hop
from bcapscope.live.recorder import Recorder
from bcapscope.messages.message_codec import decode_message
from bcapscope.proxy.relay_session import read_endpoints
from bcapscope.proxy.ring_buffer import RingRecord, RingRecordKind, hole_sizes
from bcapscope.traffic.joining.twin_recognition import CLIENT_LEG, CONTROLLER_LEG
from bcapscope.traffic.observation import Transport

_Endpoints: TypeAlias = tuple[tuple[str, int], tuple[str, int]]


@dataclass(slots=True)
class _ProxySide:
    """One leg of a client's traffic. `endpoints` holds source and target of packets to the client, then of
    packets to the controller. `begun` says whether the recording contains the start of the TCP connection.
    """

    is_client_side: bool
    is_stream: bool
    interface: Interface
    endpoints: tuple[_Endpoints, _Endpoints]
    begun: bool = False

    def hop(self, up: bool) -> Hop:
        return (*self.endpoints[up], self.interface)


_RecordStep: TypeAlias = tuple[int, _ProxySide, RingRecord, int]
"""A packet to write: time (ns since 1970), leg, record of the ring buffer, and number of that record."""

_step_time: Callable[[_RecordStep], int] = itemgetter(0)

_MAX_PAIR_ENCODERS = 1024
"""Maximum number of cached packet encoders, one per client, direction and datagram size."""


class ProxyRecorder:
    """Converts the relay's records into packets, sorts them by time, and writes them to a recording."""

    def __init__(self, recorder: Recorder, *, keeps_packet_numbers: bool = False) -> None:
        """With `keeps_packet_numbers`, keep the packet numbers until `next_packet_numbers` returns them."""
        self._recorder = recorder
        self._packet_numbers: dict[int, int] | None = {} if keeps_packet_numbers else None
        self._record_count = self._numbers_given = 0
        self._packets = recorder.packets
        self._sides: dict[int, tuple[_ProxySide, _ProxySide]] = {}
        self._steps: list[_RecordStep] = []
        self._pair_encoders: dict[
            tuple[int, bool, int], PacketPairEncoder
        ] = {}  # the key is the client, the direction (True means to the controller) and the size in bytes

    def add_records(self, records: Sequence[RingRecord]) -> None:
        """Write records in chronological order. A packet waits while earlier packets may still arrive; a
        later call of `add_records` or `flush` writes the packet.
        """
        if not self._recorder.is_complete:
            return
        written = self._write_plain_run(records)
        steps, sides, came = self._steps, self._sides, 0
        for number, record in enumerate(records[written:], self._record_count + written):
            if record.kind is RingRecordKind.CLIENT_OPENED:
                self._add_client(record)
            known = sides.get(record.client)
            if known is None:
                continue
            near, far = known
            came = max(came, record.received_at)
            if record.kind is RingRecordKind.CLIENT_OPENED or record.kind is RingRecordKind.CLIENT_CLOSED:
                steps.append((record.received_at, near, record, number))
                continue
            first, second = (near, far) if record.up else (far, near)
            if record.received_at:
                steps.append((record.received_at, first, record, number))
            if record.sent_at:
                steps.append((record.sent_at, second, record, number))
        self._record_count += len(records)
        steps.sort(key=_step_time)
        self._write_steps(bisect_right(steps, came, key=_step_time))

    def _write_plain_run(self, records: Sequence[RingRecord]) -> int:
        """Fast path: write records from the start of the list, and return how many records were written.

        The fast path writes only UDP datagrams that the relay forwarded and that no rule affected. It ends
        before the first other record, and before a record that is later than one of the records after it.

        If all `records` are later than the waiting packets, write the waiting packets first. Do not write the
        last record, because a packet that arrives later may have an earlier time.
        """
        first = [
            came if 0 < came <= left else left or came for _, _, _, came, left, _, _ in reversed(records)
        ]
        # for each record, the earliest time among this record and all following records
        soonest = [*accumulate(first, min)][::-1]
        if len(records) < 2 or (self._steps and soonest[0] < self._steps[-1][0]):
            return 0
        self._write_steps(len(self._steps))
        blocks: list[bytes] = []
        written, is_ring = 0, self._recorder.is_ring
        for (kind, up, number, came, left, data, note), following in zip(records, soonest[1:], strict=False):
            if not 0 < came <= left <= following or note or kind is not RingRecordKind.DATA:
                break
            if is_ring and self._sends_datagrams(number):
                written += self._write_blocks(blocks)
                self._begin_packet()
            make = self._pair_encoders.get((number, up, len(data))) or self._make_pair_encoder(
                number, up, len(data)
            )
            if make is None:
                break
            blocks.append(make(came, left, data))
        written += self._write_blocks(blocks)
        if self._packet_numbers is not None:
            number, packet = self._record_count, self._packets.packet_count - 2 * written + 1
            for place, record in enumerate(records[:written]):
                self._packet_numbers[number + place] = packet + 2 * place + (not record.up)
        return written

    def next_packet_numbers(self, count: int) -> list[int]:
        """Return a packet number for each of the next `count` records from the relay.

        From one record, the recorder can write several packets. The returned number is that of the record's
        last packet on the client's leg. It is 0 if the recorder wrote no packet on the client's leg for this
        record. The numbers are valid only for a recording in one file.
        """
        first, numbers = self._numbers_given, self._packet_numbers or {}
        self._numbers_given += count
        return [numbers.pop(number, 0) for number in range(first, first + count)]

    def _write_blocks(self, blocks: list[bytes]) -> int:
        count = len(blocks)
        if count:
            self._packets.write_blocks(b"".join(blocks), count)
            blocks.clear()
        return count

    def _make_pair_encoder(self, number: int, up: bool, size: int) -> PacketPairEncoder | None:
        """Return an encoder for a client's datagrams; None if the client uses TCP or is unknown."""
        if not self._sends_datagrams(number):
            return None
        if len(self._pair_encoders) >= _MAX_PAIR_ENCODERS:
            self._pair_encoders.clear()
        near, far = self._sides[number]
        first, second = (near, far) if up else (far, near)
        self._begin_packet()
        made = self._packets.datagram_pair_encoder(first.hop(up), second.hop(up), size)
        self._pair_encoders[number, up, size] = made
        return made

    def _sends_datagrams(self, number: int) -> bool:
        sides = self._sides.get(number)
        return sides is not None and not sides[0].is_stream

    def flush(self) -> None:
        self._write_steps(len(self._steps))
        self._recorder.flush()

    def close(self) -> bool:
        """Write all waiting packets and close the file. Return whether the recording is complete."""
        self.flush()
        self._recorder.close()
        return self._recorder.is_complete

    def _add_client(self, record: RingRecord) -> None:
        who = read_endpoints(record.data)
        is_stream = who.transport is Transport.TCP
        near = Interface(RAW_IP, f"{CLIENT_LEG}{who.listen}")
        far = Interface(RAW_IP, f"{CONTROLLER_LEG}{who.controller}")
        near_ends, far_ends = (who.client, who.listen), (who.upstream, who.controller)
        self._sides[record.client] = (
            _ProxySide(True, is_stream, near, (near_ends[::-1], near_ends)),
            _ProxySide(False, is_stream, far, (far_ends[::-1], far_ends)),
        )

    def _write_steps(self, count: int) -> None:
        steps, self._steps = self._steps[:count], self._steps[count:]
        for time, side, record, number in steps:
            if record.kind is RingRecordKind.DATA:
                self._add_data(time, side, record)
                if side.is_client_side and self._packet_numbers is not None:
                    self._packet_numbers[number] = self._packets.packet_count
            elif record.kind is RingRecordKind.CLIENT_CLOSED:
                self._drop_client(record.client)
            elif record.kind is RingRecordKind.HOLE:
                self._skip_bytes(side, record, time)
            elif record.kind is not RingRecordKind.CLIENT_OPENED:
                self._end_stream(side, record, time)
            elif side.is_stream:
                self._begin_stream(side, time)

    def _begin_packet(self) -> None:
        if self._recorder.begin_packet():
            self._pair_encoders.clear()  # the cached encoders refer to interfaces of the previous file

    def _begin_stream(self, side: _ProxySide, time: int) -> None:
        side.begun = True
        self._begin_packet()
        self._packets.write_handshake(*side.endpoints[1], time, interface=side.interface)

    def _add_data(self, time: int, side: _ProxySide, record: RingRecord) -> None:
        if side.is_stream and not side.begun:
            self._begin_stream(side, time)
        self._begin_packet()
        write = self._packets.write_segment if side.is_stream else self._packets.write_datagram
        write(
            *side.endpoints[record.up],
            record.data,
            time,
            interface=side.interface,
            comment=_comment(record.note),
        )

    def _skip_bytes(self, side: _ProxySide, record: RingRecord, time: int) -> None:
        came, left = hole_sizes(record)
        if not side.begun:
            self._begin_stream(side, time)
        size = came if side.is_client_side is record.up else left
        self._packets.skip_bytes(*side.endpoints[record.up], size)

    def _end_stream(self, side: _ProxySide, record: RingRecord, time: int) -> None:
        if side.begun:
            self._begin_packet()
            self._packets.write_stream_end(
                *side.endpoints[record.up],
                time,
                interface=side.interface,
                reset=record.kind is RingRecordKind.RESET,
                comment=_comment(record.data),
            )

    def _drop_client(self, client: int) -> None:
        for key in [key for key in self._pair_encoders if key[0] == client]:
            del self._pair_encoders[key]
        for side in self._sides.pop(client):
            self._packets.drop_connection(*side.endpoints[1])


def _comment(message: bytes) -> str:
    return str(decode_message(message)) if message else ""
