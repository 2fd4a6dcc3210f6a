"""Bytes as programs print them and people paste them."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator

from bcapscope.capture.hex_text import HexPacket, read_hex_text


def packets_in(text: str) -> list[HexPacket]:
    """Find the packets in a text."""
    return list(read_hex_text(lines_of(text)))


def lines_of(text: str) -> list[str]:
    """Split a text at any kind of line end."""
    return re.split("\r\n|\n|\r", text)


def rows(data: bytes, width: int = 16) -> Iterator[tuple[int, bytes]]:
    """Yield offset and bytes of each row."""
    for start in range(0, len(data), width):
        yield start, data[start : start + width]


def characters(row: bytes) -> str:
    """Show bytes as characters, dots for those that are not plain."""
    return "".join(chr(byte) if 0x20 <= byte < 0x7F else "." for byte in row)


def window(data: bytes) -> str:
    """Print as the b-CAP Tester's window does."""
    return "\n".join(row.hex(" ").upper() for _, row in rows(data))


def one_line(data: bytes) -> str:
    """Print all bytes side by side."""
    return data.hex(" ")


def hexdump(data: bytes) -> str:
    """Print as ``hexdump -C``, which leaves out rows like the one before."""
    lines = []
    last = b""
    for start, row in rows(data):
        left, right = row[:8].hex(" "), row[8:].hex(" ")
        line = f"{start:08x}  {left:<23}  {right:<23}  |{characters(row)}|"
        repeats = row == last and len(row) == 16
        if not repeats:
            lines.append(line)
        elif lines[-1] != "*":
            lines.append("*")
        last = row
    return "\n".join([*lines, f"{len(data):08x}"])


def xxd(data: bytes) -> str:
    """Print as xxd."""
    return "\n".join(f"{start:08x}: {row.hex(' ', -2):<39}  {characters(row)}" for start, row in rows(data))


def xxd_plain(data: bytes) -> str:
    """Print as ``xxd -p``."""
    return "\n".join(row.hex() for _, row in rows(data, 30))


def od_octal_offsets(data: bytes) -> str:
    """Print as ``od -t x1``."""
    lines = [f"{start:07o} {row.hex(' ')}" for start, row in rows(data)]
    return "\n".join([*lines, f"{len(data):07o}"])


def od_decimal_offsets(data: bytes) -> str:
    """Print as ``od -A d -t x1z``."""
    lines = [f"{start:07d} {row.hex(' '):<47}  >{characters(row)}<" for start, row in rows(data)]
    return "\n".join([*lines, f"{len(data):07d}"])


def od_words(data: bytes) -> str:
    """Print as od without options: octal words of the machine."""
    lines = []
    for start, row in rows(data):
        words = struct.unpack(f"<{(len(row) + 1) // 2}H", row + bytes(len(row) % 2))
        lines.append(f"{start:07o} " + " ".join(f"{word:06o}" for word in words))
    return "\n".join([*lines, f"{len(data):07o}"])


def hexdump_words(data: bytes) -> str:
    """Print as hexdump without options: words of the machine."""
    lines = []
    for start, row in rows(data):
        words = struct.unpack(f"<{(len(row) + 1) // 2}H", row + bytes(len(row) % 2))
        lines.append(f"{start:07x} " + " ".join(f"{word:04x}" for word in words))
    return "\n".join([*lines, f"{len(data):07x}"])


def wireshark_dump(data: bytes) -> str:
    """Print as Wireshark's "Copy as hex and ASCII dump"."""
    return "\n".join(f"{start:04x}   {row.hex(' '):<47}   {characters(row)}" for start, row in rows(data))


def wireshark_bare_dump(data: bytes) -> str:
    """Print as Wireshark's "Copy as hex dump"."""
    return "\n".join(f"{start:04x}   {row.hex(' ')}" for start, row in rows(data))


def wireshark_stream(data: bytes) -> str:
    """Print as Wireshark's "Copy as hex stream"."""
    return data.hex()


def wireshark_array(data: bytes) -> str:
    """Print as Wireshark's "Show data as C arrays"."""
    lines = [", ".join(f"0x{byte:02x}" for byte in row) for _, row in rows(data, 8)]
    return "char peer0_0[] = { /* Packet 1 */\n" + ",\n".join(lines) + " };"


def wireshark_escaped(data: bytes) -> str:
    """Print as Wireshark's "Copy as escaped string"."""
    return " \\\n".join('"' + "".join(f"\\x{byte:02x}" for byte in row) + '"' for _, row in rows(data))


def python_literal(data: bytes) -> str:
    """Print as Python shows bytes."""
    return f"data = {data!r}"


def tcpdump(data: bytes) -> str:
    """Print as ``tcpdump -X``."""
    return "\n".join(
        f"\t0x{start:04x}:  {row.hex(' ', -2):<39}  {characters(row)}" for start, row in rows(data)
    )


def dashes(data: bytes) -> str:
    """Print as BitConverter.ToString of .NET."""
    return data.hex("-").upper()


def debugger(data: bytes) -> str:
    """Print as DEBUG of DOS, a dash in the middle of each row."""
    pairs = (f"{row[:8].hex(' ')}-{row[8:].hex(' ')}".rstrip("-") for _, row in rows(data))
    return "\n".join(f"{16 * n:08X}  {text.upper()}" for n, text in enumerate(pairs))


FORMS: tuple[Callable[[bytes], str], ...] = (
    window,
    one_line,
    hexdump,
    xxd,
    xxd_plain,
    od_octal_offsets,
    od_decimal_offsets,
    od_words,
    hexdump_words,
    wireshark_dump,
    wireshark_bare_dump,
    wireshark_stream,
    wireshark_array,
    wireshark_escaped,
    python_literal,
    tcpdump,
    dashes,
    debugger,
)
