"""The CRC of serial-line frames, against its check value."""

from __future__ import annotations

from bcapscope.protocol.codec.frame_content import crc16


def test_has_the_check_value() -> None:
    assert crc16(b"123456789") == 0x29B1
    assert crc16(b"") == 0xFFFF
