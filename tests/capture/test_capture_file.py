"""Which kind of file it is, and packets that are shown as they come."""

from __future__ import annotations

import gzip
import io
import os
import zlib
from pathlib import Path

import pytest

from bcapscope.capture.capture_file import CaptureFile, open_capture
from bcapscope.errors import CaptureError
from tests.capture.packets import enhanced, interface, pcap, pcap_header, pcap_record, section
from tests.capture.test_pcap import read_until_damage

PCAPNG = section() + interface() + enhanced(b"abc") + enhanced(b"defg")


@pytest.mark.parametrize("content", [pcap(b"abc", b"defg"), PCAPNG], ids=["pcap", "pcapng"])
@pytest.mark.parametrize("compressed", [False, True])
def test_reads_a_file_to_its_end(tmp_path: Path, content: bytes, compressed: bool) -> None:
    path = tmp_path / "any name"
    path.write_bytes(gzip.compress(content) if compressed else content)
    with open_capture(path) as capture:
        assert capture.size == path.stat().st_size
        assert capture.position == 0
        assert [packet[1] for packet in capture] == [b"abc", b"defg"]
        assert capture.position == capture.size


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "the file is empty"),
        (b"\xd4", "this is not a capture: it begins with d4, so it is neither pcap nor pcapng"),
        (
            b"hello world",
            "this is not a capture: it begins with 68 65 6c 6c, so it is neither pcap nor pcapng",
        ),
        (
            b"\x00" * 100,
            "this is not a capture: it begins with 00 00 00 00, so it is neither pcap nor pcapng",
        ),
        (
            b"\x28\xb5\x2f\xfd....",
            "compressed by zstd, which bcapscope does not read; it reads pcap and pcapng",
        ),
        (
            b"\xa1\xb2\xcd\x34....",
            "Kuznetzov's variant of pcap, which bcapscope does not read; it reads pcap and pcapng",
        ),
        (pcap()[:20], "the capture ends inside its header, after 20 bytes"),
        (gzip.compress(b"", mtime=0), "the file is empty"),
        (
            gzip.compress(b"text", mtime=0),
            "this is not a capture: it begins with 74 65 78 74, so it is neither pcap nor pcapng",
        ),
        (gzip.compress(pcap(), mtime=0)[:5], "the compressed file ends in the middle"),
    ],
)
def test_what_is_no_capture_is_told_in_one_sentence(content: bytes, why: str) -> None:
    packets, error = read_until_damage(content)
    assert packets == []
    assert str(error) == why


def test_what_cannot_be_opened_is_told_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match=r"^cannot be opened: no such file or directory$"):
        open_capture(tmp_path / "missing")
    with pytest.raises(CaptureError, match=r"^cannot be opened: is a directory$"):
        open_capture(tmp_path)


def test_a_failing_read_is_told_in_one_sentence() -> None:
    class Failing(io.BytesIO):
        def read1(self, size: int | None = -1) -> bytes:
            raise OSError(5, "Input/output error")

    with pytest.raises(CaptureError, match=r"^reading failed: input/output error$"):
        list(CaptureFile(Failing()))


@pytest.mark.parametrize("buffering", [0, -1])
@pytest.mark.parametrize(
    ("head", "packets"),
    [
        (pcap_header(), [pcap_record(b"one"), pcap_record(b"two"), pcap_record(b"")]),
        (section() + interface(), [enhanced(b"one"), enhanced(b"two"), enhanced(b"")]),
    ],
    ids=["pcap", "pcapng"],
)
def test_packets_from_a_pipe_are_given_out_as_they_come(
    head: bytes, packets: list[bytes], buffering: int
) -> None:
    reading, writing = os.pipe()
    with os.fdopen(reading, "rb", buffering=buffering) as stream:
        capture = CaptureFile(stream)
        assert capture.size is None
        os.write(writing, head)
        shown = iter(capture)
        for packet, data in zip(packets, (b"one", b"two", b""), strict=True):
            os.write(writing, packet[:-5])
            os.write(writing, packet[-5:])
            assert next(shown)[1] == data
        os.close(writing)
        assert list(shown) == []


def test_compressed_packets_from_a_pipe_are_given_out_as_they_come() -> None:
    reading, writing = os.pipe()
    packer = zlib.compressobj(wbits=31)
    with os.fdopen(reading, "rb") as stream:
        os.write(writing, packer.compress(pcap(b"one")) + packer.flush(zlib.Z_SYNC_FLUSH))
        shown = iter(CaptureFile(stream))
        assert next(shown)[1] == b"one"
        os.write(writing, packer.compress(pcap_record(b"two")) + packer.flush(zlib.Z_SYNC_FLUSH))
        assert next(shown)[1] == b"two"
        os.write(writing, packer.flush())
        os.close(writing)
        assert list(shown) == []
