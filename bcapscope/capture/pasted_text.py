"""Turn pasted hex into observations, so that bcapscope shows the text like any other traffic."""

from __future__ import annotations

import codecs
import io
from collections.abc import Iterable, Iterator

from bcapscope.capture.byte_source import CHUNK_SIZE, ChunkReader
from bcapscope.capture.hex_text import HexPacket, read_hex_text
from bcapscope.errors import CaptureError
from bcapscope.messages import ENGLISH_WORDS, Message, MessageFormatter
from bcapscope.messages.places import WireText
from bcapscope.protocol.codec.arguments import Problem
from bcapscope.protocol.codec.frame import EOT, SMALLEST_FRAME, SOH, Frame, Malformed, parse_single_frame
from bcapscope.protocol.codec.variant import vt_name
from bcapscope.protocol.tables.command_catalogue import command_name, find_command, similar_command
from bcapscope.traffic.observation import (
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    ServerEvidence,
    ServerEvidenceKind,
    Transport,
)

LONGEST_LINE = 256 * 1024
"""Maximum number of characters in a line. The longest frames of real sessions have 60 KiB as `0x01, 0x02, …`.
"""


class PastedText:
    """Observations of the packets in a text, in the order of the text. All times are 0.

    bcapscope adds a problem to a packet whose unknown command is similar to a known command, and to a packet
    whose bytes are only one argument of a frame.

    Attributes:
        count: Number of packets read so far.
        comments: Comments on the latest packet; the key is the number of this packet.
    """

    def __init__(self, lines: Iterable[str], words: MessageFormatter = ENGLISH_WORDS) -> None:
        self.count = 0
        self.comments: dict[int, tuple[str, ...]] = {}
        self._lines = lines
        self._words = words

    def __iter__(self) -> Iterator[Observation]:
        ends = Endpoint("client", 0), Endpoint("server", 0)
        conversation = Conversation(*ends, Transport.UNKNOWN, ServerEvidence(ServerEvidenceKind.TEXT))
        flows = {direction: Flow(conversation, direction) for direction in Direction}
        for number, packet in enumerate(read_hex_text(self._lines), 1):
            flow = flows[packet.direction or Direction.REQUEST]
            self.count = number
            self.comments.clear()
            self.comments[number] = tuple(map(self._words.text, _packet_comments(packet)))
            yield Observation(number, 0, 0, flow, _decode_packet(packet), number)


def _decode_packet(packet: HexPacket) -> Frame | Malformed:
    item = parse_single_frame(packet.data)
    if isinstance(item, Malformed):
        return Malformed(item.raw, (*item.problems, *_lone_argument_problems(packet.data)))
    return Frame(item.raw, None if packet.direction is Direction.RESPONSE else _command_problem(item))


def _lone_argument_problems(data: bytes) -> Iterator[Problem]:
    size = (SMALLEST_FRAME + len(data)).to_bytes(4, "little")
    frame = Frame(bytes((SOH,)) + size + bytes(8) + b"\1\0" + data + bytes((EOT,)))
    if not frame.problems:
        vt = frame.arguments[0].variant.vt
        yield Problem(0, "argument", Message("problem.lone-argument", type=vt_name(vt)))


def _command_problem(request: Frame) -> Problem | None:
    name = command_name(request.code, request.variants) or ""
    near = similar_command(request.code, name) if find_command(request.code, name) is None else None
    if near is None:
        return None
    return Problem(request.arguments[1].start, "name", Message("problem.command", command=near))


def _packet_comments(packet: HexPacket) -> tuple[Message, ...]:
    comments = [
        Message("pasted.line.captioned", line=packet.line, caption=WireText(packet.caption))
        if packet.caption
        else Message("pasted.line", line=packet.line)
    ]
    if packet.direction is None:
        comments.append(Message("pasted.direction-unknown"))
    elif packet.is_direction_guessed:
        comments.append(Message(f"pasted.direction-by-bytes.{packet.direction.value}"))
    return (*comments, *packet.notes)


def text_lines(read: ChunkReader) -> Iterator[str]:
    """Yield the lines of a text without their line ends.

    The text is UTF-16 if it has a byte-order mark of UTF-16, else UTF-8. Other bytes become U+FFFD. Raises
    CaptureError at a line of more than `LONGEST_LINE` characters.
    """
    head = read(CHUNK_SIZE)
    while len(head) < len(codecs.BOM_UTF8) and (more := read(CHUNK_SIZE)):
        head += more
    is_wide = head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    decoder = codecs.getincrementaldecoder("utf-16" if is_wide else "utf-8-sig")("replace")
    newlines = io.IncrementalNewlineDecoder(decoder, translate=True)
    number, begun, chunk, offset = 1, "", head, 0
    while True:
        *lines, begun = (begun + newlines.decode(chunk, final=not chunk)).split("\n")
        for line in lines:
            _check_length(line, number, offset)
            yield line
            number += 1
        _check_length(begun, number, offset)
        if not chunk:
            yield begun
            return
        offset += len(chunk)
        chunk = read(CHUNK_SIZE)


def _check_length(line: str, number: int, offset: int) -> None:
    if len(line) > LONGEST_LINE:
        raise CaptureError(Message("capture.long-line", line=number, limit=LONGEST_LINE), offset)
