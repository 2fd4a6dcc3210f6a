"""Result codes against what other sources print: DENSO's headers, its slides of 2009, the ROS driver."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.tables import hresult
from bcapscope.protocol.tables.hresult import (
    CODE_BY_NAME,
    SUBSYSTEMS,
    describe_hresult,
    ends_slave_mode,
    hresult_name,
    is_failure,
    is_known_code,
    is_rc7_code,
    is_success,
    level_name,
    rc7_digits_guessed,
    with_rc7_forms,
)
from bcapscope.protocol.tables.table_rows import table_rows

ROWS = list(table_rows("hresults"))
UNSIGNED = st.integers(0, 0xFFFFFFFF)

# Symbols and values as printed in orin_bcap Java HResult.java.
JAVA_SYMBOLS = {
    "S_OK": 0x00000000,
    "S_FALSE": 0x00000001,
    "E_UNEXPECTED": 0x8000FFFF,
    "E_NOTIMPL": 0x80004001,
    "E_OUTOFMEMORY": 0x8007000E,
    "E_INVALIDARG": 0x80070057,
    "E_POINTER": 0x80004003,
    "E_HANDLE": 0x80070006,
    "E_ABORT": 0x80004004,
    "E_FAIL": 0x80004005,
    "E_ACCESSDENIED": 0x80070005,
    "E_CAO_SEM_CREATE": 0x80000200,
    "E_CAO_PROV_INVALID": 0x80000201,
    "E_CAO_COMPUTER_NAME": 0x80000202,
    "E_CAO_VARIANT_TYPE_NOSUPPORT": 0x80000203,
    "E_CAO_OBJECT_NOTFOUND": 0x80000204,
    "E_CAO_COLLECTION_REGISTERED": 0x80000205,
    "E_CAO_THREAD_CREATE": 0x80000207,
    "E_CAO_REMOTE_ENGINE": 0x80000208,
    "E_CAO_REMOTE_PROVIDER": 0x80000209,
    "E_CAO_NOT_WRITABLE": 0x8000020A,
    "E_CAO_CMD_EXECUTE": 0x8000020B,
    "E_CAO_PROV_NO_LICENSE": 0x8000020C,
    "E_CAO_PRELOAD": 0x8000020D,
    "E_CRDIMPL": 0x80000400,
    "E_CAOP_SYSTEMNAME_INVALID": 0x80000401,
    "E_CAOP_SYSTEMTYPE_INVALID": 0x80000402,
    "E_CANCEL": 0x80000403,
    "E_CAOP_NOT_WRITABLE": 0x80000404,
    "E_TIMEOUT": 0x80000900,
    "E_NO_LICENSE": 0x80000901,
    "E_NOT_CONNECTED": 0x80000902,
    "E_NOT_USE": 0x80000903,
    "E_INVALID_CMD_NAME": 0x80000904,
    "E_MAX_OBJECT": 0x80000905,
    "S_EXECUTING": 0x00000900,
    "E_INVALIDPACKET": 0x80010000,
}

# Code, level as the list of controller errors prints it, words that the text must hold.
CONTROLLER_CODES = [
    (hresult.E_NOT_IN_SLAVE_MODE, 3, "slave mode is off"),
    (hresult.E_SLAVE_UNDERFLOW, 4, "ran empty"),
    (hresult.E_SLAVE_OVERFLOW, 3, "overflow"),
    (0x81501003, 1, "motor must be on"),
    (hresult.E_ARM_NOT_TAKEN, 3, "arm semaphore"),
    (hresult.E_REFUSED_IN_SLAVE_MODE, 3, "while slave mode is on"),
    (0x805003F2, 0, "logged out"),
    (0x85201485, 5, "no memory"),
    (0x82201F91, 2, "option"),
    (0x80201418, 0, "singularity"),
    (0x803022EF, 0, "84201486"),
]


@pytest.mark.parametrize("symbol", JAVA_SYMBOLS)
def test_a_symbol_stands_for_its_code(symbol: str) -> None:
    assert CODE_BY_NAME[symbol] == JAVA_SYMBOLS[symbol]


@pytest.mark.parametrize(("name", "code"), JAVA_SYMBOLS.items())
def test_symbols_of_the_java_library(name: str, code: int) -> None:
    assert hresult_name(code) == name
    assert hresult_name(code - 2**32 if code >= 2**31 else code) == name


@pytest.mark.parametrize(("code", "level", "words"), CONTROLLER_CODES)
def test_controller_codes(code: int, level: int, words: str) -> None:
    result = describe_hresult(code)
    assert (result.level, result.is_listed, result.is_guess) == (level, True, False)
    assert words in result.text
    assert hresult_name(code) == f"0x{code:08X}"


def test_a_signed_code_as_the_python_client_raises_it() -> None:
    assert describe_hresult(-2091908831).code == 0x83500121
    assert hresult_name(-2091908831) == "0x83500121"


def test_constants_are_the_codes_that_they_name() -> None:
    ours = {"E_BUSY", "E_NOT_IN_SLAVE_MODE", "E_REFUSED_IN_SLAVE_MODE", "E_SLAVE_UNDERFLOW"}
    ours |= {"E_SLAVE_OVERFLOW", "E_ARM_NOT_TAKEN", "E_ROBOTISBUSY"}
    constants = {n: v for n, v in vars(hresult).items() if n[:2] in {"S_", "E_"} and isinstance(v, int)}
    assert constants.keys() > ours
    for name, value in constants.items():
        if name not in ours:
            assert hresult_name(value) == name
    assert hresult.E_BUSY & 0xFFFF == 170
    assert hresult_name(hresult.E_ROBOTISBUSY) == "BCAP_E_ROBOTISBUSY"


@pytest.mark.parametrize(
    ("code", "failure"),
    [
        (hresult.S_OK, False),
        (hresult.S_FALSE, False),
        (hresult.S_EXECUTING, False),
        (hresult.S_BUF_FULL, False),
        (hresult.E_TIMEOUT, True),
        (-1, True),
        (-2147467259, True),  # E_FAIL as a signed number
        (0x600B, True),  # RC7: any result but S_OK is an error
        (0x1000, True),
        (0x0FFF, False),
        (0xFFFF, True),
        (0x00010000, False),
        (0x7FFFFFFF, False),
        (0x80000000, True),
    ],
)
def test_success_and_failure(code: int, failure: bool) -> None:
    assert is_failure(code) is failure
    assert is_success(code) is (not failure)


@pytest.mark.parametrize(
    ("code", "ends"),
    [
        (0x84201482, True),
        (0x83501032, True),
        (0x83501032 - (1 << 32), True),
        (0x600B, True),  # on an RC7 any error does
        (0x83201483, False),  # set points may come again once there is room
        (0x8150100D, False),
        (0x82204021, False),
        (0x80070057, False),
        (0, False),
        (0x900, False),
        (0x0F200501, False),
    ],
)
def test_which_results_end_slave_mode(code: int, ends: bool) -> None:
    assert ends_slave_mode(code) is ends


@pytest.mark.parametrize("base", [0x84204040, 0x84204050, 0x83204070, 0x83404D10, 0x842040A0])
def test_axis_families_name_the_axis(base: int) -> None:
    for axis in range(1, 9):
        result = describe_hresult(base + axis)
        assert (result.code, result.axis, result.is_listed) == (base + axis, axis, True)
        assert result.text.startswith(f"J{axis}: ")
    assert not any(describe_hresult(base + other).is_listed for other in (0, 9))


def test_advice_stands_beside_the_meaning() -> None:
    assert str(describe_hresult(hresult.S_BUF_FULL).advice).startswith("wait one cycle")
    assert describe_hresult(hresult.E_SLAVE_UNDERFLOW).advice is not None
    assert describe_hresult(0x85201485).advice is None


@pytest.mark.parametrize(
    ("code", "level", "subsystem", "axis"),
    [
        (0x84404513, 4, "servo and safety", 3),  # "J3: excessive position error" in denso_cobotta_ros
        (0x84404519, 4, "servo and safety", None),
        (0x84404518, 4, "servo and safety", 8),
        (0x84404510, 4, "servo and safety", None),
        (0x84405513, 4, "servo and safety", None),
        (0x84204A91, 4, "motion and path", 1),
        (0x84504A91, 4, "system", None),
        (0x8100ABCD, 1, None, None),
        (0x8010ABCD, 0, None, None),
        (0x8090ABCD, 0, None, None),
        (0x83611234, 3, "user programs", None),
        (0x8286ABCD, 2, "pendant and project", None),
        (0x81201234, 1, "motion and path", None),
        (0x8599ABCD, 5, None, None),
    ],
)
def test_digits_of_an_unknown_controller_code(
    code: int, level: int, subsystem: str | None, axis: int | None
) -> None:
    result = describe_hresult(code)
    part = None if result.subsystem is None else str(result.subsystem)
    assert (result.level, part, result.axis) == (level, subsystem, axis)
    assert (result.is_listed, result.is_guess, result.name) == (False, True, None)
    assert "derived from the digits" in result.text
    assert f"level {level}" in result.text
    assert (f"J{axis}" in result.text) is (axis is not None)
    assert (part or "level") in result.text
    assert "None" not in result.text


def test_digits_say_nothing_above_level_5() -> None:
    # The driver of COBOTTA has 8F400506, whose level is 1.
    for code in (0x8F400506, 0x8620ABCD):
        result = describe_hresult(code)
        assert (result.level, result.subsystem, result.axis, result.is_listed) == (None, None, None, False)


def test_each_level_and_each_part_of_a_controller_has_a_name() -> None:
    assert len({str(level_name(level)) for level in hresult.LEVELS}) == 6
    for part in range(16):
        result = describe_hresult(0x8100ABCD | part << 20)
        assert (result.subsystem is not None) is (part in SUBSYSTEMS)


@pytest.mark.parametrize(
    ("code", "is_known"),
    [
        (hresult.E_FAIL, True),
        (0x84204043, True),  # one of a family
        (0x80070002, True),  # one of a range
        (0x600B, True),
        (0x2ABC, False),
        (0x84404519, False),
        (0x8F400506, False),
        (0x00012345, False),
    ],
)
def test_a_code_is_known_if_a_table_has_it(code: int, is_known: bool) -> None:
    assert is_known_code(code) is is_known


@pytest.mark.parametrize(
    ("code", "guessed"),
    [(0x8000600B, "600B"), (0x80001000, "1000"), (0x80000FFF, None), (0x600B, None), (0x8001600B, None)],
)
def test_the_digits_of_an_rc7_are_guessed_in_one_form_only(code: int, guessed: str | None) -> None:
    assert rc7_digits_guessed(code) == rc7_digits_guessed(code - (code >> 31 << 32)) == guessed


@pytest.mark.parametrize(
    ("code", "is_rc7"),
    [
        (0x600B, True),
        (0x8000600B, True),
        (0x1000, True),
        (0x0FFF, False),
        (0x1600B, False),
        (hresult.E_UNEXPECTED, False),
        (0x80004002, False),  # of COM
    ],
)
def test_codes_of_an_rc7_have_four_digits(code: int, is_rc7: bool) -> None:
    assert is_rc7_code(code) is is_rc7


def test_codes_of_the_same_meaning_on_an_rc7() -> None:
    assert with_rc7_forms([0x81501014]) == {0x81501014, 0x21E4, 0x800021E4}
    assert with_rc7_forms([0x600B]) == {0x600B, 0x8000600B}
    assert with_rc7_forms([hresult.E_FAIL]) == {hresult.E_FAIL}


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0x80070002, "Windows error 2"),
        (0x80912746, "socket error 10054"),
        (0x8091FFFF, "socket error 65535"),
        (0x81500143, "CAO engine"),
        (0x800002FF, "CAO engine"),
        (0x80004002, "COM"),
    ],
)
def test_ranges(code: int, words: str) -> None:
    result = describe_hresult(code)
    assert words in result.text
    assert (result.is_listed, result.is_guess) == (False, False)
    assert (result.level is None) is not (code == 0x81500143)


def test_busy_is_told_from_other_socket_errors() -> None:
    assert "busy" in describe_hresult(0x809100AA).text
    assert "busy" not in describe_hresult(0x809100AB).text


@pytest.mark.parametrize("code", [0x0000600B, 0x8000600B])
def test_600b_in_either_form_is_a_guess_with_a_meaning(code: int) -> None:
    result = describe_hresult(code)
    assert "500 ms" in result.text
    assert (result.rc7, result.level, result.is_listed, result.is_guess) == ("600B", 1, True, True)
    assert hresult_name(code) == f"0x{code:08X}"


def test_low_half_counts_only_for_a_known_rc7() -> None:
    assert describe_hresult(0x1234600B).is_listed is False
    result = describe_hresult(0x1234600B, rc7=True)
    assert (result.rc7, result.is_guess, result.code) == ("600B", True, 0x1234600B)
    assert describe_hresult(hresult.E_TIMEOUT, rc7=True).name == "E_TIMEOUT"


@pytest.mark.parametrize(
    ("rc7", "words", "axis"),
    [
        ("21D3", "error is active", None),
        ("2254", "slave mode is on", None),
        ("607F", "figure", None),
        ("6411", "J1", 1),
        ("6415", "J5", 5),
        ("6417", "J7", 7),
        ("2006", "motor", None),
    ],
)
def test_rc7_codes_carry_the_meaning_of_their_rc8_equivalent(rc7: str, words: str, axis: int | None) -> None:
    result = describe_hresult(int(rc7, 16))
    assert words in result.text
    assert (result.rc7, result.is_guess, result.axis) == (rc7, True, axis)


def test_an_rc7_code_that_is_not_in_the_table() -> None:
    result = describe_hresult(0x2ABC)
    assert (result.rc7, result.is_listed, result.is_guess) == ("2ABC", False, True)


def test_no_code_stands_twice() -> None:
    codes = [row["code"] for row in ROWS if not row["code"].endswith("x")]
    families = [row["code"][:-1] for row in ROWS if row["code"].endswith("x")]
    codes += [f"{digits}{axis}" for digits in families for axis in range(1, 9)]
    assert len(codes) == len(set(codes))
    assert len(codes) > 250


def test_texts_are_single_clauses() -> None:
    for text in (row["text"] for row in ROWS):
        assert text
        assert not text.endswith(".")
        assert text.isprintable()


def test_level_of_a_known_controller_code_is_its_second_digit() -> None:
    foreign = ("8007", "8091")  # of Windows
    digits = [row["code"] for row in ROWS if not row["name"] and not row["code"].startswith(foreign)]
    of_controllers = [each for each in digits if len(each) == 8 and each.isalnum() and "x" not in each]
    assert len(of_controllers) > 100
    for each in of_controllers:
        assert describe_hresult(int(each, 16)).level == int(each[1])


@given(UNSIGNED)
def test_any_code_is_described_signed_or_not(code: int) -> None:
    signed = code - 2**32 if code >= 2**31 else code
    result = describe_hresult(code)
    assert result == describe_hresult(signed)
    assert result.code == code
    assert result.text.isprintable()
    assert hresult_name(code) == hresult_name(signed) == (result.name or f"0x{code:08X}")
    assert is_failure(code) is is_failure(signed)
    assert describe_hresult(code, rc7=True) == describe_hresult(signed, rc7=True)
    assert not (result.is_listed and result.text.startswith("perhaps"))


@given(st.sampled_from(range(0x80000000, 0x90000000, 0x00100000)), st.integers(0, 0xFFFFF))
def test_an_axis_is_never_claimed_outside_1_to_8(prefix: int, rest: int) -> None:
    result = describe_hresult(prefix | rest)
    assert result.axis is None or (1 <= result.axis <= 8 and result.axis == rest & 0xF)
    assert result.level is None or 0 <= result.level <= 5
