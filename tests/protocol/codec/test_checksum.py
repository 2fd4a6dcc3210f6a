"""The CRC of serial-line frames, against its check value and Python's own CRC-CCITT."""

from __future__ import annotations

import binascii

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.checksum import crc16


def test_has_the_check_value() -> None:
    assert crc16(b"123456789") == 0x29B1
    assert crc16(b"") == 0xFFFF


@given(st.binary(max_size=300))
def test_is_the_crc_of_ccitt_started_with_all_ones(data: bytes) -> None:
    assert crc16(data) == binascii.crc_hqx(data, 0xFFFF)
