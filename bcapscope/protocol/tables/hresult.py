"""HRESULT: the meaning of a reply's result code. The digits of an unknown code show part of its meaning.

A result code is a number of 32 bits at offset 9 of a reply. Some clients print this number as signed, others
as unsigned; the functions in this module accept both.

Codes of RC8 and later controllers have the form 8LSnnnnn in hex digits. Digit L is the error level. Digit S
is the part of the controller that reports the error. All 7687 codes in the error list of
nkawa/Denso_CobottaPro900_MQTT_Control (src/vendor/denso_cobotta/error_list.xlsx) have the form 8LSnnnnn. No
source documents how RC7 puts its four-digit codes into 32 bits. This module therefore decodes both 0000600B
and 8000600B as RC7's 600B, and marks the meaning as a guess.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

from bcapscope.messages import Message
from bcapscope.protocol.tables.table_rows import table_rows

S_OK = 0x00000000
S_FALSE = 0x00000001
S_EXECUTING = 0x00000900
S_BUF_FULL = 0x0F200501
E_UNEXPECTED = 0x8000FFFF
E_NOTIMPL = 0x80004001
E_FAIL = 0x80004005
E_ACCESSDENIED = 0x80070005
E_HANDLE = 0x80070006
E_INVALIDARG = 0x80070057
E_ROBOTISBUSY = 0x80010004
E_CAO_COLLECTION_REGISTERED = 0x80000205
E_TIMEOUT = 0x80000900
E_NOT_CONNECTED = 0x80000902
E_MAX_OBJECT = 0x80000905
E_TOO_MUCH_DATA = 0x80000909
E_BUSY = 0x809100AA
"""The C server's reply while an earlier call of the connection runs. The name `E_BUSY` is bcapscope's own."""
E_NOT_IN_SLAVE_MODE = 0x83500121
E_REFUSED_IN_SLAVE_MODE = 0x83501032
E_SLAVE_UNDERFLOW = 0x84201482
E_SLAVE_OVERFLOW = 0x83201483
E_ARM_NOT_TAKEN = 0x83501024

_UNLISTED = frozenset({"hresult.not-listed", "hresult.rc7", "hresult.failure", "hresult.success"})

LEVELS = range(6)
"""Error levels. DENSO's error list has no names for levels 2 and 3. The names that bcapscope shows follow
from the list's descriptions of errors with these levels.
"""

_ENDS_SLAVE_MODE = 3

_GUESSED_RC7_FORM = 0x80000000
"""RC7 may send its four-digit codes xxxx as 8000xxxx. No document shows the form 8000xxxx."""

SUBSYSTEMS = frozenset((2, 4, 5, 6, 8))
"""Values of the third hex digit of a result code: motion, servo, system, user programs, pendant."""


# Without `__slots__`, the class can cache `text`. This cache speeds up the JSON of a million replies.
@dataclass(frozen=True)
class HresultInfo:
    """Everything known about a result code.

    Attributes:
        code: The result code, unsigned, 32 bits.
        name: DENSO's symbol for the code.
        level: Error level 0..5.
        subsystem: Part of the controller that reports the code.
        axis: Axis 1..8.
        rc7: The four-digit code of RC7 with the same meaning.
        is_listed: Whether a table lists the code. Otherwise, the code's digits or range give the meaning.
        is_guess: Whether `meaning` depends on an assumption that no document confirms.
    """

    code: int
    name: str | None
    meaning: Message
    advice: Message | None = None
    level: int | None = None
    subsystem: Message | None = None
    axis: int | None = None
    rc7: str | None = None
    is_listed: bool = False
    is_guess: bool = False

    @cached_property
    def text(self) -> str:
        return str(self.meaning)


def is_failure(code: int) -> bool:
    """Return whether a result code, signed or unsigned, reports a failure: its top bit is set, or it is a
    four-digit number such as 0000600B. On RC7, any code other than S_OK is an error (DENSO Wave 2009, How to
    use the Slave mode).
    """
    return bool(code & 0x80000000) or 0x1000 <= code <= 0xFFFF


def ends_slave_mode(code: int) -> bool:
    """Return whether a result code, signed or unsigned, is an error that switches slave mode off.

    Errors of level 3 and above switch slave mode off, except a buffer overflow. Every error of RC7, whose
    codes have four digits, switches slave mode off (DENSO Wave 2009, How to use the Slave mode).
    """
    code &= 0xFFFFFFFF
    if not is_failure(code) or code == E_SLAVE_OVERFLOW:
        return False
    level = describe_hresult(code).level
    return is_rc7_code(code) or (level is not None and level >= _ENDS_SLAVE_MODE)


@lru_cache(maxsize=4096)
def is_rc7_code(code: int) -> bool:
    """Return whether an otherwise unknown result code has a form of RC7's codes: 0000xxxx or 8000xxxx."""
    code &= 0xFFFFFFFF
    in_range = any(first <= code <= last for first, last, _ in RESULT_RANGES)
    return _has_rc7_form(code) and code not in LISTED_RESULTS and not in_range


def with_rc7_forms(codes: Iterable[int]) -> frozenset[int]:
    """Return `codes` together with RC7's codes of the same meaning, in the forms 0000xxxx and 8000xxxx."""
    plain = frozenset(codes)
    numbers = {int(rc7, 16) for code in plain if (rc7 := describe_hresult(code).rc7) is not None}
    return plain | numbers | {_GUESSED_RC7_FORM | number for number in numbers}


def rc7_digits_guessed(code: int) -> str | None:
    """Return the digits xxxx of a code 8000xxxx, which RC7 may send; None for any other code."""
    guessed = code & 0xFFFF0000 == _GUESSED_RC7_FORM and is_rc7_code(code)
    return f"{code & 0xFFFF:04X}" if guessed else None


def is_success(code: int) -> bool:
    """Return whether a result code, signed or unsigned, is a success, such as S_OK or S_EXECUTING."""
    return not is_failure(code)


def is_known_code(code: int) -> bool:
    """Return whether a table lists this code, either alone, or within a family or a range of codes."""
    return describe_hresult(code).meaning.id not in _UNLISTED


@lru_cache(maxsize=4096)
def hresult_name(code: int) -> str:
    """Return the name of a result code: `S_OK`, or `0x83500121` for a code without symbol."""
    return describe_hresult(code).name or f"0x{code & 0xFFFFFFFF:08X}"


@lru_cache(maxsize=4096)
def describe_hresult(code: int, *, rc7: bool = False) -> HresultInfo:
    """Return the meaning of a signed or unsigned code. If `rc7`, the code may contain an RC7 code."""
    code &= 0xFFFFFFFF
    known = LISTED_RESULTS.get(code)
    if known is not None:
        return known
    if rc7 and code & 0xFFFF in RC7_RESULTS:
        return _info_as_rc7(code)
    for first, last, row in RESULT_RANGES:
        if first <= code <= last:
            return _info_from_range(code, first, row)
    if _has_rc7_form(code):
        return _info_as_rc7(code)
    if _has_level_digits(code):
        return _info_from_digits(code)
    return HresultInfo(code, None, Message("hresult.failure" if is_failure(code) else "hresult.success"))


def _has_level_digits(code: int) -> bool:
    level, part = code >> 24 & 0xF, code >> 20 & 0xF
    return code >> 28 == 8 and level < len(LEVELS) and (level, part) != (0, 0) and code >> 16 != 0x8091


def level_name(level: int) -> Message:
    return Message(f"hresult.level.{level}")


def _level_and_subsystem(code: int) -> tuple[int | None, Message | None]:
    if not _has_level_digits(code):
        return None, None
    part = code >> 20 & 0xF
    return code >> 24 & 0xF, Message(f"hresult.part.{part}") if part in SUBSYSTEMS else None


def _axis_digit(code: int) -> int | None:
    """Return the axis in the last digit of a motion or servo code; None if the code names no axis."""
    axis = code & 0xF
    return axis if code >> 20 & 0xF in (2, 4) and code >> 12 & 0xF == 4 and 1 <= axis <= 8 else None


def _info_from_digits(code: int) -> HresultInfo:
    level, subsystem = _level_and_subsystem(code)
    axis = _axis_digit(code)
    assert level is not None  # the caller has checked `_has_level_digits`
    known = Message("hresult.by-digits", level=level, name=level_name(level))
    if subsystem is not None:
        known = Message("hresult.by-digits.part", meaning=known, part=subsystem)
    if axis is not None:
        known = Message("hresult.by-digits.axis", meaning=known, axis=axis)
    meaning = Message("hresult.not-listed", meaning=known)
    return HresultInfo(code, None, meaning, level=level, subsystem=subsystem, axis=axis, is_guess=True)


def _info_from_range(code: int, first: int, row: dict[str, str]) -> HresultInfo:
    level, subsystem = _level_and_subsystem(code)
    number, key = code & 0xFFFF, f"hresult.range.{first:08X}"
    meaning = Message.from_table(key, row["text"].format(number=number), number=number)
    return HresultInfo(code, None, meaning, _advice(key, row), level=level, subsystem=subsystem)


def _advice(key: str, row: dict[str, str]) -> Message | None:
    return Message.from_table(f"{key}.advice", row["advice"]) if row["advice"] else None


def _has_rc7_form(code: int) -> bool:
    return code >> 16 in (0, 0x8000) and code & 0xFFFF >= 0x1000


def _info_as_rc7(code: int) -> HresultInfo:
    low = code & 0xFFFF
    found = RC7_RESULTS.get(low)
    if found is not None:
        return replace(found, code=code, is_guess=True)
    digits = f"{low:04X}"
    return HresultInfo(code, None, Message("hresult.rc7", digits=digits), rc7=digits, is_guess=True)


def _info_from_row(code: int, row: dict[str, str], axis: int | None = None) -> HresultInfo:
    """Return the meaning of a listed code. Codes that differ only in the axis may share one row."""
    level, subsystem = _level_and_subsystem(code)
    key = f"hresult.{code:08X}" if axis is None else f"hresult.axis.{code & ~0xF:08X}"
    meaning = Message.from_table(key, row["text"])
    return HresultInfo(
        code,
        row["name"] or None,
        meaning if axis is None else Message("hresult.axis", axis=axis, meaning=meaning),
        _advice(key, row),
        int(row["level"]) if row["level"] else level,
        subsystem,
        axis,
        row["rc7"] or None,
        is_listed=True,
    )


def _build_table() -> dict[int, HresultInfo]:
    table: dict[int, HresultInfo] = {}
    for row in _ROWS:
        digits = row["code"]
        if digits.endswith("x"):
            base = int(digits[:-1], 16) << 4
            table |= {base + axis: _info_from_row(base + axis, row, axis) for axis in range(1, 9)}
        elif len(digits) == 8:
            table[int(digits, 16)] = _info_from_row(int(digits, 16), row)
    return table


def _build_rc7_table() -> dict[int, HresultInfo]:
    """Map RC7's four-digit codes to their meanings. A row of the table `hresults` for the four-digit code
    itself takes precedence. Otherwise, the meaning is that of the first RC8 code whose row names the
    four-digit code.
    """
    table: dict[int, HresultInfo] = {}
    for row in _ROWS:
        if len(row["code"]) == 4:
            code = int(row["code"], 16)
            axis = code & 0xF if code & 0xFFF0 == 0x6410 else None
            table[code] = replace(_info_from_row(code, row), axis=axis, rc7=row["code"])
    for result in LISTED_RESULTS.values():
        if result.rc7 is not None:
            table.setdefault(int(result.rc7, 16), result)
    return table


_ROWS = list(table_rows("hresults"))
RESULT_RANGES = [
    (int(first, 16), int(last, 16), row)
    for row in _ROWS
    for first, _, last in [row["code"].partition("-")]
    if last
]
"""First code, last code and table row of each range of codes. In the row's text, ``{number}`` stands for the
low 16 bits of a code.
"""
LISTED_RESULTS = _build_table()
RC7_RESULTS = _build_rc7_table()
"""Meanings of RC7's four-digit codes."""

CODE_BY_NAME = {row["name"]: int(row["code"], 16) for row in _ROWS if row["name"]}
"""The result code for each symbol, such as E_HANDLE."""
