"""Frames out of text: hex as people paste it from mails, documents, tools and screenshots.

What is hex in a line is found by `bcapscope.capture.hexline`; here lines become packets, with what the text
says about them. Prose, tables and words that look like hex are left aside.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from bcapscope.capture.captions import caption_direction, tidy
from bcapscope.capture.hexblock import LARGEST_REPEAT, Block
from bcapscope.capture.hexline import FEWEST, End, Hex, Piece, Text, read_line
from bcapscope.capture.link import ETHERNET, NOT_IP, find_ip, read_ip
from bcapscope.capture.sides import PORTS, evidence
from bcapscope.protocol.content import EOT, HEADER_SIZE, SOH
from bcapscope.protocol.frame import parse_bytes
from bcapscope.protocol.repair import LONGEST_SEARCHED, repair
from bcapscope.protocol.shape import LARGEST_LIKELY, reach, stated_length
from bcapscope.traffic.observation import Direction

MOST_REPEATED = 1024 * 1024
"""Bytes that all asterisks of a text may stand for, so that a short text cannot fill the memory."""

_UDP, _TCP = 17, 6
_SERIAL = slice(5, 7)


class HexPacket(NamedTuple):
    """Bytes that stand in a text as one packet.

    Attributes:
        data: one frame, sound or not, or bytes that are none.
        direction: who sent it; None where neither the text nor the bytes tell.
        guessed: the direction follows from the bytes only.
        caption: the words that stand over it, or before it on its line; else empty. Not to be trusted, as
            everything that was pasted.
        line: where it begins, 1 for the first line of the text.
        notes: what is odd about it that its bytes do not show, a clause each.
    """

    data: bytes
    direction: Direction | None
    guessed: bool
    caption: str
    line: int
    notes: tuple[str, ...]


def read_hex_text(lines: Iterable[str]) -> Iterator[HexPacket]:
    """Find the packets in the lines of a text, in their order; none where there is no hex.

    Yields a packet as soon as the lines after it show that it is complete.

    Raises:
        CaptureError: as `lines` does.
    """
    packets = (packet for block in _joined(_blocks(lines)) for packet in _packets(block))
    return _with_serials_compared(packets)


def _blocks(lines: Iterable[str]) -> Iterator[Block]:
    """Yield the blocks of a text, including those that turn out not to be hex."""
    reader = _Reader()
    for number, line in enumerate(lines, 1):
        reader.read(number, read_line(line))
        yield from reader.complete()
    if reader.last is not None:
        yield reader.last


class _Reader:
    """Assembles blocks from the hex of lines.

    Attributes:
        last: the latest block, which further lines may belong to.
    """

    def __init__(self) -> None:
        self.last: Block | None = None
        self._complete: list[Block] = []
        self._open: Block | None = None
        self._caption = ""
        self._said: Direction | None = None
        self._caption_line = 0
        self._heard = False
        self._tail: tuple[int, Hex] | None = None
        self._room = MOST_REPEATED

    def read(self, number: int, pieces: list[Piece]) -> None:
        """Take the pieces of line `number`."""
        if not pieces and self._open is not None:
            self._open.paused = True
        for piece in pieces:
            if isinstance(piece, Text):
                self._words(number, piece.text)
            elif isinstance(piece, Hex):
                self._hex(number, piece)
            elif isinstance(piece, End):
                self._end(number, piece.digits)
            elif self._open is not None:
                self._open.repeats = min(LARGEST_REPEAT, self._room)

    def complete(self) -> list[Block]:
        """Return the blocks that nothing is added to any more, each once."""
        complete, self._complete = self._complete, []
        return complete

    def _words(self, number: int, words: str) -> None:
        said = caption_direction(words)
        follows = self._heard and number - self._caption_line <= 1 and self._said is not None
        self._open = None
        self._heard = True
        if follows and (said is None or words.casefold() in self._caption.casefold()):
            return
        self._caption, self._said, self._caption_line = words, said, number

    def _hex(self, number: int, piece: Hex) -> None:
        if piece.offset:
            self._dump_row(number, piece)
        elif not (piece.alone or piece.marked) and len(piece.digits) < 2 * FEWEST:
            self._few(number, piece)
        elif self._open is not None and not self._open.paused:
            self._add(self._open, number, piece)
        else:
            self._begin(number, piece)

    def _dump_row(self, number: int, piece: Hex) -> None:
        """Go on with the last block if the offset fits; characters that were wrapped may stand between."""
        last = self.last
        if last is not None and last.indent == piece.indent and self._reach(last, piece.offset, number):
            self._open, self._heard = last, False
            self._add(last, number, piece)
        else:
            self._begin(number, piece)

    def _reach(self, block: Block, offset: str, number: int) -> bool:
        size = block.size
        reached = block.reach(offset, number)
        self._room -= max(block.size - size, 0)
        return reached

    def _few(self, number: int, piece: Hex) -> None:
        """Take a few bytes beside words: the end of a frame, or the beginning of what the next line has."""
        block = self._open
        is_short = block is not None and block.size <= LONGEST_SEARCHED
        if piece.starts_line and block and is_short and len(piece.digits) <= 2 * _missing(block.data):
            block.add(number, piece)
        elif piece.ends_line:
            self._tail = number, piece

    def _begin(self, number: int, piece: Hex) -> None:
        block = Block(self._caption, self._said, self._heard, piece)
        tail = self._tail
        if tail and tail[0] == number - 1 and piece.alone and not piece.offset and not _begins(piece.digits):
            block.add(*tail)
        block.add(number, piece)
        self._follow(block)
        self._heard, self._tail = False, None

    def _add(self, block: Block, number: int, piece: Hex) -> None:
        """Add a row to the last block; from a full block, carry over only the incomplete frame."""
        block.add(number, piece)
        if block.is_full:
            self._follow(block.split(_last_begun(block)))

    def _follow(self, block: Block) -> None:
        """Begin another block."""
        if self.last is not None:
            self._complete.append(self.last)
        self.last = self._open = block

    def _end(self, number: int, digits: str) -> None:
        if self._open is not None and self._open.offset and self._reach(self._open, digits, number):
            self._open = None
        else:
            self._hex(number, Hex(digits, "", 0, True, False, True, True))


def _last_begun(block: Block) -> int:
    """Return where in a full block the last frame begins; 0 if that would leave too much."""
    start = _cuts(block.data, [place for place, _ in block.lines()])[-1] if _is_frame(block.data) else 0
    return start if block.size - start <= LARGEST_LIKELY else 0


def _begins(digits: str) -> bool:
    return _is_frame(bytes.fromhex(digits[: len(digits) & ~1]))


def _is_frame(data: bytes) -> bool:
    """Tell whether `data` begins as a frame does."""
    return data[:1] == bytes((SOH,)) and stated_length(data) is not None


def _missing(data: bytes) -> int:
    """Return how many bytes the frame lacks that `data` ends with; 0 where there is none."""
    last = data[_cuts(data, [])[-1] :]
    length = stated_length(last) if _is_frame(last) else None
    return max(length - len(last), 0) if length else 0


def _joined(blocks: Iterable[Block]) -> Iterator[Block]:
    """Put together what only blank lines separate, and leave aside what is no hex after all."""
    pending: Block | None = None
    for block in blocks:
        if pending is not None and not block.captioned and not block.anew and _continues(pending, block):
            pending.extend(block)
        elif _is_hex(block):
            if pending is not None:
                yield pending
            pending = block
    if pending is not None:
        yield pending


def _continues(before: Block, block: Block) -> bool:
    """Tell whether `block` is more of a frame that is not whole; a lone byte may be the number of a page."""
    data = block.data
    lacking = _missing(before.data)
    return not _is_frame(data) and (len(data) == lacking or 2 <= len(data) < lacking)


def _is_hex(block: Block) -> bool:
    """Tell whether a block holds bytes of b-CAP: most of these are zeros, and few other numbers are."""
    data = block.data
    if block.captioned and block.said is not None:
        return len(data) >= FEWEST // 2
    if len(data) < FEWEST:
        return False
    if _is_frame(data) or block.marked or 4 * data.count(0) >= len(data):
        return True
    return block.alone and not block.digits.isdigit()


def _packets(block: Block) -> Iterator[HexPacket]:
    data, by_port, notes = block.data, None, list(block.notes)
    if len(block.digits) % 2:
        notes.append("the text ends in the middle of a byte")
    lines = block.lines()
    if not _is_frame(data):
        data, by_port, skipped = _unwrapped(data)
        if skipped:
            notes.append(f"headers of {skipped} bytes, down to the port, taken off")
            lines = [(max(place - skipped, 0), line) for place, line in lines]
    cuts = _cuts(data, [place for place, _ in lines])
    for start, stop in zip(cuts, [*cuts[1:], len(data)], strict=True):
        part = data[start:stop]
        direction, guessed, doubts = _direction(part, block, by_port)
        line = lines[bisect_right(lines, start, key=lambda entry: entry[0]) - 1][1]
        caption = tidy(block.caption)
        yield HexPacket(part, direction, guessed, caption, line, (*notes, *doubts))
        notes = []


def _cuts(data: bytes, rows: list[int]) -> list[int]:
    """Return where the frames in `data` begin: behind a whole one, else at a row that looks like one."""
    cuts = [0]
    while True:
        start = cuts[-1]
        head = data[start : start + 5]
        stop = start + ((stated_length(head) if _is_frame(head) else None) or len(data))
        if stop < len(data) and data[stop - 1] == EOT and data[stop] == SOH:
            cuts.append(stop)
            continue
        later = range(bisect_right(rows, start), len(rows) if stop != len(data) else 0)
        begun = (rows[at] for at in later if _begins_row(data, rows[at]))
        row = next(begun, None)
        if row is None:
            return cuts
        cuts.append(row)


def _begins_row(data: bytes, row: int) -> bool:
    return data[row - 1 : row] == bytes((EOT,)) and _is_frame(data[row : row + 5])


def _direction(
    part: bytes, block: Block, by_port: Direction | None
) -> tuple[Direction | None, bool, list[str]]:
    """Return who sent a packet, whether that is a guess, and what speaks against it."""
    content = _by_content(part)
    if by_port is not None:
        return by_port, False, []
    if block.said is None or not block.captioned:
        return content or block.said, (content or block.said) is not None, []
    shown = evidence(parse_bytes(part))
    if shown is None or shown[0] is block.said:
        return block.said, False, []
    return block.said, False, [f"called a {block.said}, but it holds {shown[1]}"]


def _by_content(part: bytes) -> Direction | None:
    """Tell a request from a reply by what only one of them can hold, if need be once repaired."""
    if not _is_frame(part) or len(part) < HEADER_SIZE:
        return None
    shown = evidence(parse_bytes(part))
    if shown is not None:
        return shown[0]
    mended = repair(part)
    if mended is not None:
        part = mended.raw
    size = len(part) + (mended.missing if mended else 0)
    as_request, as_reply = reach(part, size, True), reach(part, size, False)
    if as_request == as_reply:
        return None
    return Direction.REQUEST if as_request > as_reply else Direction.RESPONSE


def _unwrapped(data: bytes) -> tuple[bytes, Direction | None, int]:
    """Take a frame out of a whole packet from the network card: payload, sender, bytes before it."""
    for start in (find_ip(ETHERNET, data), 0):
        packet = read_ip(data, start) if start != NOT_IP and data else None
        if packet is None or packet.fragment is not None:
            continue
        segment = packet.payload
        size = 8 if packet.protocol == _UDP else 4 * (segment[12] >> 4) if len(segment) > 12 else len(segment)
        payload = segment[size:]
        if packet.protocol in (_UDP, _TCP) and _is_frame(payload):
            return payload, _by_ports(segment), data.index(segment) + size
    return data, None, 0


def _by_ports(segment: bytes) -> Direction | None:
    source, target = (int.from_bytes(segment[at : at + 2]) in PORTS for at in (0, 2))
    if source == target:
        return None
    return Direction.RESPONSE if source else Direction.REQUEST


def _with_serials_compared(packets: Iterable[HexPacket]) -> Iterator[HexPacket]:
    """Add a note to each reply whose serial no request before it has."""
    asked: set[int] = set()
    last = 0
    for packet in packets:
        noted = packet
        if _is_frame(packet.data) and len(packet.data) >= HEADER_SIZE:
            serial = int.from_bytes(packet.data[_SERIAL], "little")
            if packet.direction is Direction.REQUEST:
                asked.add(serial)
                last = serial
            elif packet.direction is Direction.RESPONSE and asked and serial not in asked:
                note = f"serial {serial}, the request above has {last}: they do not belong together"
                noted = packet._replace(notes=(*packet.notes, note))
        yield noted
