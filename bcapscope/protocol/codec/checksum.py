"""The CRC of frames on a serial line."""

from __future__ import annotations


def _table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1
        table.append(crc & 0xFFFF)
    return tuple(table)


_TABLE = _table()


def crc16(data: bytes) -> int:
    """Return the CRC-16 of a serial-line frame.

    Polynomial 0x1021, start value 0xFFFF, most significant bit first, no reflection, no final inversion;
    ``b"123456789"`` gives 0x29B1 (orin_bcap C/src/bcap_common.c; Java agrees). In a frame, the CRC covers the
    bytes from the length field to the last argument. The CRC is stored low byte first, directly before EOT.
    """
    crc = 0xFFFF
    for byte in data:
        crc = (crc << 8 & 0xFFFF) ^ _TABLE[crc >> 8 ^ byte]
    return crc
