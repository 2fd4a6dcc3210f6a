"""Find frames in text: hex that people paste from mails, documents, tools and screenshots."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from bcapscope.capture.hex_block import LARGEST_REPEAT, HexBlock
from bcapscope.capture.hex_line import MIN_HEX_BYTES, EndOffset, HexDigits, LinePiece, ProseText, parse_line
from bcapscope.capture.link_layer import ETHERNET, NOT_IP, find_ip, read_ip
from bcapscope.capture.role_detection import BCAP_PORTS, direction_evidence
from bcapscope.messages import Message
from bcapscope.messages.places import Count
from bcapscope.protocol.codec.frame import Malformed, parse_single_frame
from bcapscope.protocol.codec.frame_content import EOT, HEADER_SIZE, SMALLEST_FRAME, SOH
from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.protocol.tables.hresult import S_FALSE, describe_hresult
from bcapscope.traffic.observation import Direction

MAX_REPEATED = 1024 * 1024
"""Maximum total number of bytes that asterisk lines add to one text, so that they cannot fill the memory."""

LARGEST_LIKELY = 64 * 1024
"""Largest plausible value of the length field, in bytes. Frames of real sessions have less than 10 KiB."""

_LONGEST_COMPLETED = 1024
"""Maximum number of bytes in a block to which bcapscope adds bytes from a line that also has words. These
bytes may be the end of the block's last frame. UDP frames have at most 503 bytes (orin_bcap dn_udp.h).
"""

LONGEST_CAPTION = 120

LONGEST_PARAGRAPH = 500
"""Number of characters, at the end of a paragraph, in which bcapscope searches for words such as "TX"."""

_SENTENCE_END = re.compile(r"(?<=[.!?。])\s+")

_CLIENT = r"(?:client|pc|host|tester)"
_SERVER = r"(?:server|controller|robot|rc[789]\w?)"
_ARROW = r"\s*(?:[-=]*>|[\u2190-\u21ff\u27f5-\u27ff]|to(?:\s+the)?\b)\s*"
_ARROWS = (
    (Direction.REQUEST, re.compile(_CLIENT + _ARROW + _SERVER)),
    (Direction.RESPONSE, re.compile(_SERVER + _ARROW + _CLIENT)),
)
_NAMES = (
    (
        Direction.REQUEST,
        re.compile(r"\b(?:tx\d*|sent|send|sending|send_?data|requests?|query|transmit(?:ted)?)\b|送信|要求"),
    ),
    (
        Direction.RESPONSE,
        re.compile(
            r"\b(?:rx\d*|recv|receiv(?:e|ed|ing)|receive_?data|responses?|reply|replies|answer)\b|受信|応答"
        ),
    ),
)

_UDP, _TCP = 17, 6
_SERIAL = slice(5, 7)


class HexPacket(NamedTuple):
    """A packet that was found in a text.

    Attributes:
        data: A frame, which may be damaged, or bytes that are not a frame.
        direction: Direction of the frame; None if neither the text nor the bytes show it.
        is_direction_guessed: Whether `direction` follows only from the bytes.
        caption: Untrusted words above the hex, or before the hex on its line; "" if there are none.
        line: Number of the line on which the packet begins, from 1.
        notes: What was unusual in the text and cannot be seen from the bytes.
    """

    data: bytes
    direction: Direction | None
    is_direction_guessed: bool
    caption: str
    line: int
    notes: tuple[Message, ...]


def read_hex_text(lines: Iterable[str]) -> Iterator[HexPacket]:
    """Yield the packets in the lines of a text as soon as they are complete. Prose and tables are ignored."""
    packets = (packet for block in _join_blocks(_read_blocks(lines)) for packet in _packets_in(block))
    return _note_serial_mismatches(packets)


def _read_blocks(lines: Iterable[str]) -> Iterator[HexBlock]:
    reader = _BlockReader()
    for number, line in enumerate(lines, 1):
        reader.add_line(number, parse_line(line))
        yield from reader.finished
        reader.finished.clear()
    if reader.last is not None:
        yield reader.last


class _BlockReader:
    """Assembles blocks from the hex in successive lines. Further lines may continue the block `last`."""

    def __init__(self) -> None:
        self.last: HexBlock | None = None
        self.finished: list[HexBlock] = []
        self._open: HexBlock | None = None
        self._caption = ""
        self._direction: Direction | None = None
        self._caption_line = 0
        self._has_new_caption = False
        self._tail: tuple[int, HexDigits] | None = None
        self._repeat_budget = MAX_REPEATED

    def add_line(self, number: int, pieces: list[LinePiece]) -> None:
        if not pieces and self._open is not None:
            self._open.blank_line_follows = True
        for piece in pieces:
            if isinstance(piece, ProseText):
                self._add_words(number, piece.text)
            elif isinstance(piece, HexDigits):
                self._add_hex(number, piece)
            elif isinstance(piece, EndOffset):
                self._add_end_offset(number, piece.digits)
            elif self._open is not None:
                self._open.asterisk_bytes = min(LARGEST_REPEAT, self._repeat_budget)

    def _add_words(self, number: int, words: str) -> None:
        stated = caption_direction(words)
        follows = self._has_new_caption and number - self._caption_line <= 1 and self._direction is not None
        self._open = None
        self._has_new_caption = True
        if follows and (stated is None or words.casefold() in self._caption.casefold()):
            return
        self._caption, self._direction, self._caption_line = words, stated, number

    def _add_hex(self, number: int, piece: HexDigits) -> None:
        if piece.offset:
            self._add_dump_row(number, piece)
        elif not (piece.is_hex_only or piece.has_hex_notation) and len(piece.digits) < 2 * MIN_HEX_BYTES:
            self._add_few_bytes(number, piece)
        elif self._open is not None and not self._open.blank_line_follows:
            self._add_row(self._open, number, piece)
        else:
            self._begin_block(number, piece)

    def _add_dump_row(self, number: int, piece: HexDigits) -> None:
        last = self.last
        if last and last.indent == piece.indent and self._fit_to_offset(last, piece.offset, number):
            self._open, self._has_new_caption = last, False
            self._add_row(last, number, piece)
        else:
            self._begin_block(number, piece)

    def _fit_to_offset(self, block: HexBlock, offset: str, number: int) -> bool:
        size = block.size
        reached = block.fit_to_offset(offset, number)
        self._repeat_budget -= max(block.size - size, 0)
        return reached

    def _add_few_bytes(self, number: int, piece: HexDigits) -> None:
        """Handle the bytes of a line that also has words. Bytes at the start of the line may be the end of
        the frame above. Bytes at the end of the line may be the start of the block below.
        """
        block = self._open
        is_short = block is not None and block.size <= _LONGEST_COMPLETED
        if piece.starts_line and block and is_short and len(piece.digits) <= 2 * _missing_bytes(block.data):
            block.add(number, piece)
        elif piece.ends_line:
            self._tail = number, piece

    def _begin_block(self, number: int, piece: HexDigits) -> None:
        block = HexBlock(self._caption, self._direction, self._has_new_caption, piece)
        tail = self._tail
        if (
            tail
            and tail[0] == number - 1
            and piece.is_hex_only
            and not piece.offset
            and not _begins_as_frame(bytes.fromhex(piece.digits[: len(piece.digits) & ~1]))
        ):
            block.add(*tail)
        block.add(number, piece)
        self._set_last_block(block)
        self._has_new_caption, self._tail = False, None

    def _add_row(self, block: HexBlock, number: int, piece: HexDigits) -> None:
        block.add(number, piece)
        if block.is_full:
            self._set_last_block(block.split(_last_frame_start(block)))

    def _set_last_block(self, block: HexBlock) -> None:
        if self.last is not None:
            self.finished.append(self.last)
        self.last = self._open = block

    def _add_end_offset(self, number: int, digits: str) -> None:
        if self._open is not None and self._open.offset and self._fit_to_offset(self._open, digits, number):
            self._open = None
        else:
            self._add_hex(number, HexDigits(digits, "", 0, True, False, True, True))


def _last_frame_start(block: HexBlock) -> int:
    """Return the offset of the last frame; 0 if no frame begins the block, or the last frame is too long."""
    if not _begins_as_frame(block.data):
        return 0
    start = _frame_starts(block.data, [place for place, _ in block.line_numbers()])[-1]
    return start if block.size - start <= LARGEST_LIKELY else 0


def _frame_length(data: bytes) -> int | None:
    """Return the length that the frame at the start of `data` states; None if this length is implausible."""
    length = int.from_bytes(data[1:5], "little") if len(data) >= 5 and data[0] == SOH else 0
    return length if SMALLEST_FRAME <= length <= LARGEST_LIKELY else None


def _begins_as_frame(data: bytes) -> bool:
    return _frame_length(data) is not None


def _missing_bytes(data: bytes) -> int:
    """Return how many bytes the last frame in `data` lacks; 0 if `data` holds no frame."""
    last = data[_frame_starts(data, [])[-1] :]
    return max((_frame_length(last) or 0) - len(last), 0)


def _join_blocks(blocks: Iterable[HexBlock]) -> Iterator[HexBlock]:
    """Join blocks that belong to one frame, and drop blocks that do not hold b-CAP."""
    pending: HexBlock | None = None
    for block in blocks:
        if pending is not None and _continues_frame(pending, block):
            pending.extend(block)
        elif _is_bcap_hex(block):
            if pending is not None:
                yield pending
            pending = block
    if pending is not None:
        yield pending


def _continues_frame(before: HexBlock, block: HexBlock) -> bool:
    """Return whether `block` continues a frame. A lone byte that completes no frame may be a page number."""
    data = block.data
    if block.is_captioned or block.starts_at_zero or _begins_as_frame(data):
        return False
    lacking = _missing_bytes(before.data)
    return len(data) == lacking or 2 <= len(data) < lacking


def _is_bcap_hex(block: HexBlock) -> bool:
    """Return whether a block probably holds b-CAP, whose frames contain more zero bytes than other hex."""
    data = block.data
    if block.is_captioned and block.direction is not None:
        return len(data) >= MIN_HEX_BYTES // 2
    if len(data) < MIN_HEX_BYTES:
        return False
    if _begins_as_frame(data) or block.has_hex_notation or 4 * data.count(0) >= len(data):
        return True
    return block.is_hex_only and not block.digits.isdigit()


def _packets_in(block: HexBlock) -> Iterator[HexPacket]:
    data, by_port, notes = block.data, None, list(block.notes)
    if len(block.digits) % 2:
        notes.append(Message("pasted.half-byte"))
    lines = block.line_numbers()
    if not _begins_as_frame(data):
        data, by_port, skipped = _without_headers(data)
        if skipped:
            notes.append(Message("pasted.headers", removed=Count(skipped, "byte")))
            lines = [(max(place - skipped, 0), line) for place, line in lines]
    cuts = _frame_starts(data, [place for place, _ in lines])
    for start, stop in zip(cuts, [*cuts[1:], len(data)], strict=True):
        part = data[start:stop]
        direction, guessed, contradictions = _direction_of(part, block, by_port)
        line = lines[bisect_right(lines, start, key=lambda entry: entry[0]) - 1][1]
        caption = shorten_caption(block.caption)
        yield HexPacket(part, direction, guessed, caption, line, (*notes, *contradictions))
        notes = []


def _frame_starts(data: bytes, rows: list[int]) -> list[int]:
    """Return the offsets at which frames begin. `rows` holds the offset of each row of the text.

    The first frame begins at 0. If a SOH follows a whole frame, the next frame begins at this SOH. Otherwise,
    the next frame begins at the next row that looks like a frame and follows an EOT.
    """
    cuts = [0]
    while True:
        start = cuts[-1]
        head = data[start : start + 5]
        stop = start + (_frame_length(head) or len(data))
        if stop < len(data) and data[stop - 1] == EOT and data[stop] == SOH:
            cuts.append(stop)
            continue
        later = range(bisect_right(rows, start), len(rows) if stop != len(data) else 0)
        after_eot = (rows[at] for at in later if data[rows[at] - 1 : rows[at]] == bytes((EOT,)))
        row = next((row for row in after_eot if _begins_as_frame(data[row : row + 5])), None)
        if row is None:
            return cuts
        cuts.append(row)


def _direction_of(
    part: bytes, block: HexBlock, by_port: Direction | None
) -> tuple[Direction | None, bool, list[Message]]:
    """Return the direction, whether it is a guess, and a note if caption and bytes contradict each other."""
    content = _direction_by_content(part)
    if by_port is not None:
        return by_port, False, []
    if block.direction is None or not block.is_captioned:
        return content or block.direction, (content or block.direction) is not None, []
    shown = direction_evidence(parse_single_frame(part))
    if shown is None or shown[0] is block.direction:
        return block.direction, False, []
    return block.direction, False, [Message(f"pasted.contradicts.{shown[0].value}")]


def _direction_by_content(part: bytes) -> Direction | None:
    """Return the direction that the function id or result code shows, even in a damaged frame."""
    item = parse_single_frame(part)
    if isinstance(item, Malformed) or not _begins_as_frame(part):
        return None
    shown = direction_evidence(item)
    if shown is not None:
        return shown[0]
    if item.code in FUNCTIONS and not (item.code == S_FALSE and item.argc == 0):
        return None if item.code == S_FALSE else Direction.REQUEST
    return Direction.RESPONSE if describe_hresult(item.code).is_listed else None


def _without_headers(data: bytes) -> tuple[bytes, Direction | None, int]:
    """Return a network packet's payload, its direction according to its ports, and its headers' size."""
    for start in (find_ip(ETHERNET, data), 0):
        packet = read_ip(data, start) if start != NOT_IP and data else None
        if packet is None or packet.fragment is not None:
            continue
        segment = packet.payload
        size = 8 if packet.protocol == _UDP else 4 * (segment[12] >> 4) if len(segment) > 12 else len(segment)
        payload = segment[size:]
        if packet.protocol in (_UDP, _TCP) and _begins_as_frame(payload):
            return payload, _direction_by_ports(segment), data.index(segment) + size
    return data, None, 0


def _direction_by_ports(segment: bytes) -> Direction | None:
    source, target = (int.from_bytes(segment[at : at + 2]) in BCAP_PORTS for at in (0, 2))
    if source == target:
        return None
    return Direction.RESPONSE if source else Direction.REQUEST


def _note_serial_mismatches(packets: Iterable[HexPacket]) -> Iterator[HexPacket]:
    request_serials: set[int] = set()
    last = 0
    for packet in packets:
        noted = packet
        if _begins_as_frame(packet.data) and len(packet.data) >= HEADER_SIZE:
            serial = int.from_bytes(packet.data[_SERIAL], "little")
            if packet.direction is Direction.REQUEST:
                request_serials.add(serial)
                last = serial
            elif packet.direction is Direction.RESPONSE and request_serials and serial not in request_serials:
                note = Message("pasted.serial", serial=serial, request=last)
                noted = packet._replace(notes=(*packet.notes, note))
        yield noted


def caption_direction(caption: str) -> Direction | None:
    """Return the direction that words such as "TX" or "受信" state. The last sentence takes precedence."""
    last = _SENTENCE_END.split(caption[-LONGEST_PARAGRAPH:])[-1]
    return _direction_in(last) or _direction_in(caption[-LONGEST_PARAGRAPH:])


def _direction_in(words: str) -> Direction | None:
    words = words.casefold()
    for forms in (_ARROWS, _NAMES):
        stated = [direction for direction, form in forms if form.search(words)]
        if stated:
            return stated[0] if len(stated) == 1 else None
    return None


def shorten_caption(words: str) -> str:
    """Return a caption without decoration; for a long paragraph, only the end of its last sentence."""
    words = words.strip(" \t-*#•:=")
    return words if len(words) <= LONGEST_CAPTION else _SENTENCE_END.split(words)[-1][-LONGEST_CAPTION:]
