"""Result codes with a known name or meaning, from the table `hresults.tsv`; `hresult` describes any code."""

from __future__ import annotations

from typing import NamedTuple

from bcapscope.protocol.tables.table_rows import table_rows


class HresultEntry(NamedTuple):
    """Meaning of a result code.

    Attributes:
        code: The result code, unsigned.
        name: The vendor's symbol; None if unknown.
        text: What the code means, one clause.
        advice: What to do about the code; None without advice.
        rc7: The four-digit code of RC7 with the same meaning; None if unknown.
        level: Error level of a four-digit code; None if unknown. Other codes have the level in their digits.
    """

    code: int
    name: str | None
    text: str
    advice: str | None = None
    rc7: str | None = None
    level: int | None = None


class AxisFamily(NamedTuple):
    """Eight result codes that differ only in the last digit, the axis 1..8; `base` has axis 0."""

    base: int
    text: str
    advice: str | None = None


class CodeRange(NamedTuple):
    """A range of result codes with a common meaning; `{number}` in `text` stands for the low 16 bits."""

    first: int
    last: int
    text: str
    advice: str | None = None


def _entry(row: dict[str, str]) -> HresultEntry:
    return HresultEntry(
        int(row["code"], 16),
        row["name"] or None,
        row["text"],
        row["advice"] or None,
        row["rc7"] or None,
        int(row["level"]) if row["level"] else None,
    )


def _family(row: dict[str, str]) -> AxisFamily:
    return AxisFamily(int(row["code"].replace("x", "0"), 16), row["text"], row["advice"] or None)


def _range(row: dict[str, str]) -> CodeRange:
    first, last = (int(code, 16) for code in row["code"].split("-"))
    return CodeRange(first, last, row["text"], row["advice"] or None)


_ROWS = list(table_rows("hresults"))
_SINGLE_CODES = [_entry(row) for row in _ROWS if row["code"].isalnum() and "x" not in row["code"]]

LISTED_CODES = tuple(entry for entry in _SINGLE_CODES if not 0x1000 <= entry.code <= 0xFFFF)
AXIS_FAMILIES = tuple(_family(row) for row in _ROWS if row["code"].endswith("x"))
CODE_RANGES = tuple(_range(row) for row in _ROWS if "-" in row["code"])
RC7_CODES = tuple(entry for entry in _SINGLE_CODES if 0x1000 <= entry.code <= 0xFFFF)
"""Four-digit codes of RC7 that RC7's own papers explain."""
