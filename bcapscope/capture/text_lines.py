"""Read the lines of a text of any length in bounded memory."""

from __future__ import annotations

import codecs
import io
from collections.abc import Iterator

from bcapscope.capture.byte_source import CHUNK_SIZE, ChunkReader
from bcapscope.errors import CaptureError
from bcapscope.messages import Message

LONGEST_LINE = 256 * 1024
"""Maximum number of characters in a line. The longest frames of real sessions have 10 KiB and take 60 KiB
when written as `0x01, 0x02, …`.
"""


def text_lines(read: ChunkReader) -> Iterator[str]:
    """Yield the lines of a text without their line ends.

    A text with a UTF-16 byte-order mark is decoded as UTF-16, any other text as UTF-8. Bytes that cannot be
    decoded become U+FFFD.

    Raises:
        CaptureError: A line is longer than `LONGEST_LINE` characters. All earlier lines were yielded.
    """
    head = read(CHUNK_SIZE)
    while len(head) < len(codecs.BOM_UTF8) and (more := read(CHUNK_SIZE)):
        head += more
    is_wide = head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    decoder = codecs.getincrementaldecoder("utf-16" if is_wide else "utf-8-sig")("replace")
    newlines = io.IncrementalNewlineDecoder(decoder, translate=True)
    number, begun, chunk, offset = 1, "", head, 0
    while chunk:
        *lines, begun = (begun + newlines.decode(chunk)).split("\n")
        for line in lines:
            _check_length(line, number, offset)
            yield line
            number += 1
        _check_length(begun, number, offset)
        offset += len(chunk)
        chunk = read(CHUNK_SIZE)
    *lines, begun = (begun + newlines.decode(b"", final=True)).split("\n")
    yield from lines
    yield begun


def _check_length(line: str, number: int, offset: int) -> None:
    if len(line) > LONGEST_LINE:
        raise CaptureError(Message("capture.long-line", line=number, limit=LONGEST_LINE), offset)
