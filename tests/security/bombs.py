"""Captures that unpack to far more than their size: no command that reads may exceed 300 MB.

Each bomb is a capture compressed by gzip, of at most a few megabytes. Every command that reads captures reads
every bomb.
"""

from __future__ import annotations

import gzip
import itertools
import os
import struct
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TypeAlias

from tests.security.harness import MEMORY_LIMIT, Ended, run_measured

MEGABYTE = 1 << 20
EMPTY, I2, R8, BSTR, BOOL, VARIANT, UI1, ARRAY = 0, 2, 5, 8, 11, 12, 17, 0x2000
EXECUTE, CONNECT, FILE_PUT_VALUE = 64, 3, 40
SERVER = bytes((10, 0, 0, 1)), 5007
START = 1_700_000_000_000_000
_SEGMENT = 60_000

Maker: TypeAlias = Callable[[], Iterator[bytes]]
"""Yields the pieces of a capture."""


def value(vt: int, count: int, data: bytes) -> bytes:
    """Return a VARIANT as it is inside an array."""
    return struct.pack("<HI", vt, count) + data


def argument(vt: int, count: int, data: bytes) -> bytes:
    """Return a VARIANT as an argument of a frame."""
    return struct.pack("<I", 6 + len(data)) + value(vt, count, data)


def text(characters: str) -> bytes:
    """Return the data of a BSTR."""
    data = characters.encode("utf-16-le")
    return struct.pack("<I", len(data)) + data


def frame(serial: int, code: int, *arguments: bytes, argc: int | None = None) -> bytes:
    """Return a plain frame."""
    body = b"".join(arguments)
    count = len(arguments) if argc is None else argc
    return struct.pack("<BIHHIH", 1, 16 + len(body), serial, 0, code, count) + body + b"\x04"


def compressed(plain: bytes) -> bytes:
    """Return the same frame in the compressed framing of version 1."""
    inner = plain[9:-1]
    body = struct.pack("<I", len(inner)) + zlib.compress(inner, 9) + b"\x01"
    return struct.pack("<BI", 1, 10 + len(body)) + plain[5:7] + b"\x01\x00" + body + b"\x04"


def payload(name: str, size: int) -> bytes:
    """Return the argument of a frame: about `size` bytes of as many elements as fit."""
    vt, element, count = ELEMENTS[name]
    if vt == BSTR:
        return argument(vt, 1, struct.pack("<I", size // 2 * 2) + element * (size // 2))
    repeats = size // len(element)
    return argument(vt, repeats * count, element * repeats)


ELEMENTS = {
    "empty elements": (ARRAY | VARIANT, value(EMPTY, 0, b""), 1),
    "empty arrays": (ARRAY | VARIANT, value(ARRAY | VARIANT, 0, b""), 1),
    "nests": (ARRAY | VARIANT, value(ARRAY | VARIANT, 1, b"") * 30 + value(EMPTY, 0, b""), 1),
    "scalars with wrong counts": (ARRAY | VARIANT, value(UI1, 9, b"\0"), 1),
    "one-letter strings": (ARRAY | BSTR, text("\u4e00"), 1),
    "booleans": (ARRAY | BOOL, bytes(2), 1),
    "small numbers": (ARRAY | I2, b"\x39\x30", 1),
    "large numbers": (ARRAY | R8, struct.pack("<d", 1.5), 1),
    "bytes": (ARRAY | UI1, b"\xff", 1),
    "a string": (BSTR, "\u4e00".encode("utf-16-le"), 1),
    "an unprintable string": (BSTR, "\x1b".encode("utf-16-le"), 1),
}
"""Type of an argument, bytes that it consists of, and how many elements these are."""


def ip(data: bytes, *, port: int, tcp_at: int | None = None, down: bool = False, protocol: int = 17) -> bytes:
    """Return an IP packet between a client's `port` and the controller; TCP from offset `tcp_at`."""
    client = bytes((10, 0, 1, 2)), port
    (source, sport), (target, dport) = (SERVER, client) if down else (client, SERVER)
    if tcp_at is None:
        content = struct.pack(">HHHH", sport, dport, 8 + len(data), 0) + data
    else:
        protocol = 6
        content = struct.pack(">HHIIBBHHH", sport, dport, 1 + tcp_at, 1, 0x50, 0, 65535, 0, 0) + data
    head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(content), 0, 0, 64, protocol, 0)
    return head + source + target + content


def stream(data: bytes, port: int, start: int = 0, down: bool = False) -> Iterator[bytes]:
    """Yield TCP segments that carry `data`."""
    for at in range(0, len(data), _SEGMENT):
        yield ip(data[at : at + _SEGMENT], port=port, tcp_at=start + at, down=down)


def handshake(port: int) -> bytes:
    """Return the SYN that begins a stream."""
    packet = ip(b"", port=port, tcp_at=-1)
    return packet[:33] + b"\x02" + packet[34:]


def pcap(packets: Iterable[bytes]) -> Iterator[bytes]:
    """Yield a capture of IP packets, one each millisecond."""
    yield struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 262144, 101)
    for number, packet in enumerate(packets):
        seconds, micros = divmod(START + 1000 * number, 1_000_000)
        yield struct.pack("<IIII", seconds, micros, len(packet), len(packet)) + packet


def block(kind: int, body: bytes) -> bytes:
    """Return a pcapng block."""
    body += bytes(-len(body) % 4)
    size = struct.pack("<I", 12 + len(body))
    return struct.pack("<I", kind) + size + body + size


def option(code: int, data: bytes) -> bytes:
    """Return a pcapng option."""
    return struct.pack("<HH", code, len(data)) + data + bytes(-len(data) % 4)


SECTION = block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
INTERFACE = block(1, struct.pack("<HHI", 101, 0, 0))


def noted(packet: bytes, options: bytes) -> bytes:
    """Return an enhanced packet block with options."""
    head = struct.pack("<IIIII", 0, START >> 32, START & 0xFFFFFFFF, len(packet), len(packet))
    return block(6, head + packet + bytes(-len(packet) % 4) + options)


def _command(name: str) -> bytes:
    return argument(BSTR, 1, text(name))


_HANDLE = argument(3, 1, struct.pack("<i", 1))


def _one_frame(content: bytes, repeats: int, *, pack: bool = True) -> Iterator[bytes]:
    """Yield slvMove requests and replies with the same content, over TCP, from eight clients."""
    for serial in range(1, repeats + 1):
        port = 20000 + serial % 8
        request = frame(serial, EXECUTE, _HANDLE, _command("slvMove"), content)
        reply = frame(serial, 0, content)
        for data, down in ((request, False), (reply, True)):
            raw = compressed(data) if pack else data
            yield from stream(raw, port, 2 * serial * 20 * MEGABYTE, down)


def packed(name: str, size: int, repeats: int) -> Iterator[bytes]:
    """Yield a capture of compressed frames."""
    return pcap(_one_frame(payload(name, size), repeats))


def plain(name: str, size: int, repeats: int) -> Iterator[bytes]:
    """Yield a capture of frames that only gzip compresses."""
    return pcap(_one_frame(payload(name, size), repeats, pack=False))


def packed_datagrams(size: int, repeats: int) -> Iterator[bytes]:
    """Yield unanswered requests over UDP, each of which unpacks to `size` bytes, all kept open."""
    content = payload("empty elements", size)
    raw = compressed(frame(0, EXECUTE, _HANDLE, _command("x"), content))
    assert len(raw) < 65000, len(raw)
    for serial in range(1, repeats + 1):
        yield ip(raw[:5] + struct.pack("<H", serial % 65536) + raw[7:], port=20000 + serial % 4)


def many_arguments(repeats: int) -> Iterator[bytes]:
    """Yield frames of 65,535 arguments."""
    body = argument(EMPTY, 0, b"") * 65535
    for serial in range(1, repeats + 1):
        yield from stream(compressed(frame(serial, EXECUTE, body, argc=65535)), 20000 + serial)
        yield from stream(frame(serial, EXECUTE, body, argc=65535), 30000 + serial)


def unfinished(connections: int, size: int) -> Iterator[bytes]:
    """Yield connections that each hold the beginning of a frame of 16 MB."""
    head = struct.pack("<BIHHIH", 1, 16 * MEGABYTE, 1, 0, EXECUTE, 1)
    head += argument(ARRAY | UI1, 16 * MEGABYTE - 100, b"")[4:]
    head = head[:15] + struct.pack("<I", 16 * MEGABYTE - 20) + head[15:]
    yield from (handshake(10000 + number) for number in range(connections))
    for at in range(0, size, _SEGMENT):
        for number in range(connections):
            data = head + bytes(_SEGMENT - len(head)) if at == 0 else bytes(_SEGMENT)
            yield ip(data, port=10000 + number, tcp_at=at)


def out_of_order(connections: int, size: int) -> Iterator[bytes]:
    """Yield connections whose second byte never comes."""
    yield from (handshake(10000 + number) for number in range(connections))
    for at in range(0, size, _SEGMENT):
        for number in range(connections):
            yield ip(bytes(_SEGMENT), port=10000 + number, tcp_at=2 + at)


def tiny_segments(connections: int, size: int) -> Iterator[bytes]:
    """Yield connections that each bring the beginning of a frame byte by byte."""
    head = struct.pack("<BIHHIH", 1, 30_000, 1, 0, EXECUTE, 1) + struct.pack("<I", 29_984) + bytes(size)
    yield from (handshake(10000 + number) for number in range(connections))
    for at in range(size):
        for number in range(connections):
            yield ip(head[at : at + 1], port=10000 + number, tcp_at=at)


def answered_calls(repeats: int, size: int, code: int) -> Iterator[bytes]:
    """Yield calls that are answered with `code`, large on both ways."""
    body = argument(ARRAY | UI1, size, bytes(size))
    for number in range(repeats):
        serial, port = 1 + number % 65000, 20000 + number % 40
        yield ip(frame(serial, EXECUTE, _HANDLE, _command("slvMove"), body), port=port)
        yield ip(frame(serial, code, body), port=port, down=True)


def long_names(repeats: int, size: int) -> Iterator[bytes]:
    """Yield commands and objects with names of `size` bytes, all different."""
    for serial in range(1, repeats + 1):
        name = argument(BSTR, 1, text(f"{serial}" + "\u4e00" * (size // 2)))
        at = serial * 40 * MEGABYTE
        execute = compressed(frame(serial, EXECUTE, _HANDLE, name, argument(EMPTY, 0, b"")))
        connect = compressed(frame(serial, CONNECT, name, name, name, name))
        handle = frame(serial, 0, argument(3, 1, struct.pack("<i", serial)))
        yield from stream(execute, 20000, at)
        yield from stream(handle, 20000, at, down=True)
        yield from stream(connect, 20001, at)
        yield from stream(handle, 20001, at, down=True)


def retries(repeats: int, size: int) -> Iterator[bytes]:
    """Yield one call with ever more large retries and replies."""
    body = frame(1, EXECUTE, _HANDLE, _command("x"), argument(ARRAY | UI1, size, bytes(size)))
    for number in range(repeats):
        serial = 1 + number % 65000
        yield ip(body[:5] + struct.pack("<HH", serial, 1 if number else 0) + body[9:], port=20000)
        notice = frame(serial, 0x900, argument(ARRAY | UI1, size, bytes(size)))
        yield ip(notice, port=20000, down=True)


def open_calls(repeats: int, size: int, conversations: int) -> Iterator[bytes]:
    """Yield calls that are never answered, from many clients."""
    for number in range(repeats):
        body = argument(ARRAY | UI1, size, bytes(size))
        raw = frame(1 + number % 65000, EXECUTE, _HANDLE, _command("x"), body)
        yield ip(raw, port=10000 + number % conversations)


def conversations(count: int, calls: int) -> Iterator[bytes]:
    """Yield many clients, each of which asks for many unknown functions."""
    number = itertools.count(1)
    for serial in range(1, calls + 1):
        for port in range(1024, 1024 + count):
            yield ip(frame(serial, next(number) * 7919 % 2**31, _HANDLE), port=port)


def forms(count: int, size: int) -> Iterator[bytes]:
    """Yield frames each of which has another form, all as large as a form that is learnt may be."""
    for number in range(count):
        types = [I2, BOOL, UI1, 18] + [(I2, 18)[number >> bit & 1] for bit in range(16)]
        widths = {I2: 2, BOOL: 2, UI1: 1, 18: 2}
        rest = (size - 60) // 8
        elements = [value(vt, 1, b"\x39\x30"[: widths[vt]]) for vt in (types * rest)[:rest]]
        nested = argument(ARRAY | VARIANT, len(elements), b"".join(elements))
        serial = 1 + number % 65000
        yield ip(frame(serial, EXECUTE, _HANDLE, _command("slvMove"), nested), port=20000)
        yield ip(frame(serial, 0, nested), port=20000, down=True)


def comments(packets: int, size: int) -> Iterator[bytes]:
    """Yield a pcapng whose packets have long comments."""
    yield SECTION + INTERFACE
    notes = option(1, b"\xe4\xb8\x80" * (min(size, 65000) // 3)) * max(size // 65000, 1)
    for serial in range(1, packets + 1):
        yield noted(ip(frame(serial % 65000, 22, _HANDLE), port=20000), notes)


def interfaces(count: int, size: int) -> Iterator[bytes]:
    """Yield a pcapng of many interfaces with long names."""
    yield SECTION
    one = block(1, struct.pack("<HHI", 101, 0, 0) + option(2, b"\xe4\xb8\x80" * (size // 3)))
    for _ in range(count):
        yield one
    yield noted(ip(frame(1, 22, _HANDLE), port=20000), b"")


def absurd_blocks() -> Iterator[bytes]:
    """Yield a pcapng with a block of 16 MB, then one that claims 4 GB; its section claims 2^63 bytes."""
    yield block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, 2**63 - 1)) + INTERFACE
    yield block(5, bytes(16 * MEGABYTE - 12))
    yield noted(ip(frame(1, 22, _HANDLE), port=20000), b"")
    yield struct.pack("<II", 6, 0xFFFFFFFC) + bytes(1000)


def zeros(size: int) -> Iterator[bytes]:
    """Yield one packet, then zeros: records that say nothing."""
    yield from pcap([ip(frame(1, 22, _HANDLE), port=20000)])
    for _ in range(size // MEGABYTE):
        yield bytes(MEGABYTE)


def bombs(scale: float = 1.0) -> dict[str, Maker]:
    """Return what makes each bomb, by its name; `scale` 1 unpacks to about a gigabyte."""
    size = int(15 * MEGABYTE * min(scale, 1))
    some = max(int(20 * scale), 1)

    def of(make: Callable[..., Iterator[bytes]], *words: object) -> Maker:
        return lambda: make(*words)

    def captured(make: Callable[..., Iterator[bytes]], *words: object) -> Maker:
        return lambda: pcap(make(*words))

    def scaled(number: int) -> int:
        return max(int(number * scale), 2)

    named = {f"{name}, packed": of(packed, name, size, some) for name in ELEMENTS}
    named |= {f"{name}, plain": of(plain, name, size, max(some // 4, 1)) for name in ELEMENTS}
    return named | {
        "packed datagrams": captured(packed_datagrams, size, scaled(200)),
        "many arguments": captured(many_arguments, scaled(50)),
        "unfinished frames": captured(unfinished, 1000, scaled(1_200_000)),
        "streams out of order": captured(out_of_order, 1000, scaled(1_200_000)),
        "tiny segments": captured(tiny_segments, 1000, scaled(400)),
        "answered calls": captured(answered_calls, scaled(10_000), 50_000, 0),
        "refused calls": captured(answered_calls, scaled(10_000), 50_000, 0x83500121),
        "long names": captured(long_names, scaled(40), size),
        "large retries": captured(retries, scaled(10_000), 50_000),
        "large open calls": captured(open_calls, scaled(20_000), 50_000, 300),
        "small open calls": captured(open_calls, scaled(100_000), 50, 300),
        "conversations": captured(conversations, scaled(60_000), 3),
        "serials": captured(conversations, 300, scaled(1000)),
        "forms": captured(forms, scaled(10_000), 1000),
        "comments": of(comments, scaled(5000), 200_000),
        "interfaces": of(interfaces, scaled(20_000), 65_000),
        "absurd blocks": absurd_blocks,
        "zeros": of(zeros, scaled(1000) * MEGABYTE),
    }


def commands(path: Path, folder: Path) -> dict[str, Sequence[str | Path]]:
    """Return every command that reads a capture."""
    return {
        "decode": ["decode", path],
        "decode --json": ["decode", "--json", path],
        "decode --csv": ["decode", "--csv", path],
        "decode --tree": ["decode", "--tree", path],
        "decode --tree --full --hex": ["decode", "--tree", "--full", "--hex", path],
        "decode -f": ["decode", "-f", "command contains 'x' and arg[2] contains 3", path],
        "calls": ["calls", path],
        "calls --json": ["calls", "--json", path],
        "calls --tree": ["calls", "--tree", path],
        "stats": ["stats", path],
        "stats --json": ["stats", "--json", path],
        "compare": ["compare", path, path],
        "slave": ["slave", path],
        "slave --json": ["slave", "--json", path],
        "diagnose": ["diagnose", path],
        "diagnose --json": ["diagnose", "--json", path],
        "report": ["report", path, "--force", "-o", folder / "report.html"],
        "extract": ["extract", path, "--force", "-o", folder / "extract.csv"],
    }


def write(path: Path, pieces: Iterable[bytes]) -> None:
    """Write a bomb."""
    with gzip.open(path, "wb", compresslevel=1) as file:
        for piece in pieces:
            file.write(piece)


def write_apart(path: Path, name: str, scale: float) -> None:
    """Write a bomb from another process: the peak of a child begins with that of its parent."""
    subprocess.run(
        [sys.executable, "-m", "tests.security.bombs", "--write", path, name, str(scale)], check=True
    )


def attack(folder: Path, scale: float, wanted: str = "", command: str = "") -> Iterator[tuple[str, Ended]]:
    """Let every command read every bomb whose name contains `wanted`; yield how each ended."""
    for name in bombs(scale):
        if wanted not in name:
            continue
        path = folder / "bomb.pcap.gz"
        write_apart(path, name, scale)
        for words, argv in commands(path, folder).items():
            if command in (words, ""):
                yield f"{name}: {words}", run_measured(argv, patience=600)


def main() -> None:
    """Report each bomb and command; exit with 1 if one used too much."""
    if sys.argv[1:2] == ["--write"]:
        path, name, scale = sys.argv[2:]
        write(Path(path), bombs(float(scale))[name]())
        return
    wanted, command = (*sys.argv[1:], "", "")[:2]
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        for what, ended in attack(Path(name), float(os.environ.get("BOMB_SCALE", "1")), wanted, command):
            bad = ended.peak >= MEMORY_LIMIT
            failed += bad
            print(
                f"{what}: {ended.peak:.0f} MB, {ended.seconds:.1f} s, exit {ended.code}"
                f"{'  TOO MUCH' if bad else ''}",
                flush=True,
            )
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
