"""The recording of a proxy: both sides of all traffic, each on its own interface."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from itertools import accumulate
from operator import itemgetter
from pathlib import Path
from typing import TypeAlias

from bcapscope.capture.packet import Interface
from bcapscope.capture.pcapng_writer import PacketPairEncoder
from bcapscope.capture.rotating_recording import RotatingRecording, RotationLimits
from bcapscope.capture.socket_recording import RAW_IP, Hop, SocketRecording
from bcapscope.messages.os_errors import os_reason
from bcapscope.proxy.relay_session import read_endpoints
from bcapscope.proxy.ring_buffer import RingRecord, RingRecordKind, hole_sizes
from bcapscope.render.escape import printable
from bcapscope.traffic.observation import Transport

_Endpoints: TypeAlias = tuple[tuple[str, int], tuple[str, int]]


class _ProxySide:
    """One side of a client's traffic: between client and proxy, or between proxy and controller.

    Attributes:
        interface: The pcapng interface of this side.
        is_client_side: True between client and proxy.
        is_stream: True for TCP.
        begun: True once the connection is in the recording.
        endpoints: Source and target: toward the client at index 0, toward the controller at index 1.
    """

    __slots__ = ("begun", "endpoints", "interface", "is_client_side", "is_stream")

    def __init__(
        self,
        name: str,
        client: tuple[str, int],
        controller: tuple[str, int],
        *,
        is_client_side: bool,
        is_stream: bool,
    ) -> None:
        self.interface = Interface(RAW_IP, name)
        self.is_client_side = is_client_side
        self.is_stream = is_stream
        self.begun = False
        self.endpoints: tuple[_Endpoints, _Endpoints] = (controller, client), (client, controller)

    def hop(self, up: bool) -> Hop:
        """Return source, target and interface of datagrams in one direction."""
        return (*self.endpoints[up], self.interface)


_RecordStep: TypeAlias = tuple[int, _ProxySide, RingRecord]
"""Time of a packet in ns since 1970, its side, and the record that it comes from."""

_step_time: Callable[[_RecordStep], int] = itemgetter(0)

_MAX_PAIR_ENCODERS = 1024
"""Encoders that are kept, one for each client, direction and size. Beyond that, all are discarded."""


class ProxyRecorder:
    """Writes the relay's traffic to a capture. If that fails, it warns and continues without a recording.

    Attributes:
        failed: True if the capture is incomplete because a file could not be written.
    """

    def __init__(self, path: Path, ring: RotationLimits | None, warn: Callable[[str], None]) -> None:
        """Create the file.

        Raises:
            OSError: The file cannot be written.
        """
        self._series: RotatingRecording | None = RotatingRecording(path, ring)
        self.failed = self._has_warned_full = False
        self._path = path
        self._warn = warn
        self._sides: dict[int, tuple[_ProxySide, _ProxySide]] = {}
        self._steps: list[_RecordStep] = []
        self._is_ring = ring is not None
        self._pair_encoders: dict[
            tuple[int, bool, int], PacketPairEncoder
        ] = {}  # by client, direction (up) and bytes

    def add_records(self, records: Sequence[RingRecord]) -> None:
        """Write records in the order of time. Packets that another may still precede wait for `flush`."""
        if self._series is None:
            return
        rest = records[self._write_plain_run(records) :]
        if self._series is None:
            return
        steps, legs, came = self._steps, self._sides, 0
        for record in rest:
            if record.kind is RingRecordKind.CLIENT_OPENED:
                self._add_client(record)
            known = legs.get(record.client)
            if known is None:
                continue
            near, far = known
            came = max(came, record.received_at)
            if record.kind is RingRecordKind.CLIENT_OPENED or record.kind is RingRecordKind.CLIENT_CLOSED:
                steps.append((record.received_at, near, record))
                continue
            first, second = (near, far) if record.up else (far, near)
            if record.received_at:
                steps.append((record.received_at, first, record))
            if record.sent_at:
                steps.append((record.sent_at, second, record))
        steps.sort(key=_step_time)
        self._write_steps(bisect_right(steps, came, key=_step_time))

    def _write_plain_run(self, records: Sequence[RingRecord]) -> int:
        """Write leading records that are datagrams forwarded unchanged, one after another. Most records are.

        Packets that wait are written first, provided that all of `records` is later.

        Returns:
            Number of records written, counted from the first. The last record is never written, as an earlier
            packet may follow it.
        """
        first = [
            came if 0 < came <= left else left or came for _, _, _, came, left, _, _ in reversed(records)
        ]
        soonest = [*accumulate(first, min)][::-1]  # earliest time of each record and all later ones
        if len(records) < 2 or (self._steps and soonest[0] < self._steps[-1][0]):
            return 0
        self._write_steps(len(self._steps))
        if self._series is None:
            return 0
        blocks: list[bytes] = []
        written = 0
        try:
            for (kind, up, number, came, left, data, note), following in zip(
                records, soonest[1:], strict=False
            ):
                if not 0 < came <= left <= following or note or kind is not RingRecordKind.DATA:
                    break
                if self._is_ring and self._sends_datagrams(number):
                    written += self._write_blocks(blocks)
                    self._current_recording()
                make = self._pair_encoders.get((number, up, len(data))) or self._make_pair_encoder(
                    number, up, len(data)
                )
                if make is None:
                    break
                blocks.append(make(came, left, data))
            written += self._write_blocks(blocks)
        except OSError as error:
            self._give_up(error)
        return written

    def _write_blocks(self, blocks: list[bytes]) -> int:
        """Write the blocks and empty the list. Return how many blocks there were."""
        assert self._series is not None
        count = len(blocks)
        if count:
            self._series.recording.write_blocks(b"".join(blocks))
            blocks.clear()
        return count

    def _make_pair_encoder(self, number: int, up: bool, size: int) -> PacketPairEncoder | None:
        """Return an encoder for datagrams of this size. None for a stream or an unknown client."""
        if not self._sends_datagrams(number):
            return None
        if len(self._pair_encoders) >= _MAX_PAIR_ENCODERS:
            self._pair_encoders.clear()
        near, far = self._sides[number]
        first, second = (near, far) if up else (far, near)
        made = self._current_recording().datagram_pair_encoder(first.hop(up), second.hop(up), size)
        self._pair_encoders[number, up, size] = made
        return made

    def _sends_datagrams(self, number: int) -> bool:
        """Return whether a client is known and uses UDP."""
        legs = self._sides.get(number)
        return legs is not None and not legs[0].is_stream

    def flush(self) -> None:
        """Write all waiting packets to the file."""
        self._write_steps(len(self._steps))
        if self._series is not None:
            try:
                self._series.flush()
            except OSError as error:
                self._give_up(error)
            else:
                self._warn_if_freed(self._series.files_freed)

    def _warn_if_freed(self, freed: int) -> None:
        """Warn once that the disk is too small for the ring of files."""
        if freed and not self._has_warned_full:
            self._has_warned_full = True
            name = printable(str(self._path))
            self._warn(f"the disk is full: the recording {name} removes its oldest files early")

    def close(self) -> None:
        """Write all waiting packets and close the file."""
        self.flush()
        self._close_file()

    def _close_file(self) -> None:
        self._steps.clear()
        if self._series is not None:
            self._series.close()
            self._series = None

    def _add_client(self, record: RingRecord) -> None:
        who = read_endpoints(record.data)
        is_stream = who.transport is Transport.TCP
        self._sides[record.client] = (
            _ProxySide(
                f"clients of {who.listen}", who.client, who.listen, is_client_side=True, is_stream=is_stream
            ),
            _ProxySide(
                f"controller {who.controller}",
                who.upstream,
                who.controller,
                is_client_side=False,
                is_stream=is_stream,
            ),
        )

    def _write_steps(self, count: int) -> None:
        """Write the first `count` steps."""
        steps, self._steps = self._steps[:count], self._steps[count:]
        try:
            for time, leg, record in steps:
                if record.kind is RingRecordKind.DATA:
                    self._add_data(time, leg, record)
                else:
                    self._open_or_end(time, leg, record)
        except OSError as error:
            self._give_up(error)

    def _open_or_end(self, time: int, leg: _ProxySide, record: RingRecord) -> None:
        if record.kind is RingRecordKind.CLIENT_CLOSED:
            self._drop_client(record.client)
        elif record.kind is RingRecordKind.HOLE:
            self._skip_bytes(leg, record, time)
        elif record.kind is not RingRecordKind.CLIENT_OPENED:
            self._end_stream(leg, record, time)
        elif leg.is_stream:
            self._begin_stream(leg, time)

    def _give_up(self, error: OSError) -> None:
        self.failed = True
        why = os_reason(error)
        self._warn(f"{printable(str(self._path))} is not written any more: {why}")
        self._close_file()

    def _current_recording(self) -> SocketRecording:
        """Return the recording to write to, after changing to the next file if the current one is full."""
        assert self._series is not None
        if self._series.rotate_if_full():
            self._pair_encoders.clear()  # they refer to interfaces of the previous file
        return self._series.recording

    def _begin_stream(self, leg: _ProxySide, time: int) -> None:
        leg.begun = True
        self._current_recording().write_handshake(*leg.endpoints[1], time, interface=leg.interface)

    def _add_data(self, time: int, leg: _ProxySide, record: RingRecord) -> None:
        source, target = leg.endpoints[record.up]
        data, note = record.data, record.note
        if leg.is_stream:
            if not leg.begun:
                self._begin_stream(leg, time)
            self._current_recording().write_segment(
                source, target, data, time, interface=leg.interface, comment=note
            )
        else:
            self._current_recording().write_datagram(
                source, target, data, time, interface=leg.interface, comment=note
            )

    def _skip_bytes(self, leg: _ProxySide, record: RingRecord, time: int) -> None:
        """Leave a gap in the sequence numbers."""
        assert self._series is not None
        came, left = hole_sizes(record)
        if not leg.begun:
            self._begin_stream(leg, time)
        self._series.recording.skip_bytes(
            *leg.endpoints[record.up], came if leg.is_client_side is record.up else left
        )

    def _end_stream(self, leg: _ProxySide, record: RingRecord, time: int) -> None:
        """Write the end of one direction, if the connection is in the recording."""
        if leg.begun:
            self._current_recording().write_stream_end(
                *leg.endpoints[record.up],
                time,
                interface=leg.interface,
                reset=record.kind is RingRecordKind.RESET,
                comment=record.data.decode("utf-8", "replace"),
            )

    def _drop_client(self, client: int) -> None:
        assert self._series is not None
        for key in [key for key in self._pair_encoders if key[0] == client]:
            del self._pair_encoders[key]
        for leg in self._sides.pop(client):
            self._series.recording.drop_connection(*leg.endpoints[1])
