"""Arguments read one by one: what a frame holds, and how far it can be read when it is damaged."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec import arguments as arguments_module
from bcapscope.protocol.codec.arguments import MAX_NUMBERS, Argument, ArgumentReader, NumberSpan
from bcapscope.protocol.codec.variant import ARRAY, MAX_NESTING, VT, Variant, encode_argument
from tests.frames import (
    ARGUMENT_IDS,
    ARGUMENTS,
    DAMAGED,
    DAMAGED_IDS,
    ArgumentPair,
    Damaged,
    bare,
    nested,
    values_of,
)
from tests.fuzz.targets import check_arguments
from tests.strategies import variants


def read(raw: bytes, argc: int = 1, pos: int = 0, end: int | None = None) -> ArgumentReader:
    reader = ArgumentReader(raw, pos, len(raw) if end is None else end)
    reader.read(argc)
    return reader


@pytest.mark.parametrize("pair", ARGUMENTS, ids=ARGUMENT_IDS)
def test_reads_what_the_bytes_say(pair: ArgumentPair) -> None:
    reader = read(pair.data)
    assert repr(reader.arguments) == repr([Argument(bare(pair.variant), 0, len(pair.data))])
    assert reader.problems == []
    assert reader.pos == len(pair.data)
    assert reader.is_complete


@pytest.mark.parametrize("pair", ARGUMENTS, ids=ARGUMENT_IDS)
def test_reads_two_glued_and_nothing_behind_the_end(pair: ArgumentPair) -> None:
    size = len(pair.data)
    reader = read(b"??" + pair.data * 3, argc=2, pos=2, end=2 + 2 * size)
    expected = [
        Argument(bare(pair.variant), 2, 2 + size),
        Argument(bare(pair.variant), 2 + size, 2 + 2 * size),
    ]
    assert repr(reader.arguments) == repr(expected)
    assert reader.problems == []


@pytest.mark.parametrize("pair", ARGUMENTS, ids=ARGUMENT_IDS)
def test_an_argument_cut_anywhere_has_a_problem_and_a_part_of_its_value(pair: ArgumentPair) -> None:
    for end in range(len(pair.data)):
        reader = read(pair.data, end=end)
        assert reader.problems, end
        assert all(0 <= problem.offset <= end for problem in reader.problems)
        assert len(reader.arguments) == (1 if end >= 10 else 0)
        assert all(argument.variant.vt == pair.variant.vt for argument in reader.arguments)


@pytest.mark.parametrize("sample", DAMAGED, ids=DAMAGED_IDS)
def test_damaged_arguments_are_read_as_far_as_they_go(sample: Damaged) -> None:
    argc = int.from_bytes(sample.data[13:15], "little")
    reader = read(sample.data, argc, 15, max(15, len(sample.data) - 1))
    found = values_of(tuple(argument.variant for argument in reader.arguments))
    assert repr(found) == repr(sample.values)
    expected = [mark for mark in sample.problems if mark[1] not in ("length", "left-over", "eot")]
    marks = sorted(reader.problems, key=lambda problem: problem.offset)
    assert [(problem.offset, problem.code) for problem in marks] == expected


def test_numbers_are_told_where_they_stand() -> None:
    by_name = {pair.name: pair.data for pair in ARGUMENTS}
    assert read(by_name["I4"]).number_spans == [NumberSpan(10, "i", 1)]
    assert read(by_name["UI1 array"]).number_spans == [NumberSpan(10, "s", 3)]
    assert read(by_name["VARIANT array"]).number_spans == [NumberSpan(16, "d", 2), NumberSpan(38, "i", 1)]
    assert read(by_name["BOOL array"]).number_spans == []
    assert (
        read(by_name["R8 array, empty"]).number_spans == read(by_name["UI1 array, empty"]).number_spans == []
    )


@pytest.mark.parametrize("data", ["0100", "0080", "FF00"])
def test_any_bool_but_zero_is_true(data: str) -> None:
    reader = read(bytes.fromhex("08000000 0B00 01000000" + data))
    assert [argument.variant.value for argument in reader.arguments] == [True]
    assert reader.problems == []


def test_the_count_of_empty_is_kept() -> None:
    assert read(bytes.fromhex("06000000 0000 00000000")).arguments[0].variant.elements == 0


def test_a_promise_says_how_much_there_is() -> None:
    (problem,) = read(bytes.fromhex("0E000000 0520 04000000 000000000000F03F")).problems
    assert str(problem.reason) == "4 elements of VT_R8 declared, but there are bytes for 1"
    (problem,) = read(bytes.fromhex("06000000 0300 01000000")).problems
    assert str(problem.reason) == "1 element of VT_I4 declared, but there are bytes for 0"
    (problem,) = read(b"??" + bytes.fromhex("0A000000 1120 05000000 616263"), pos=2).problems
    assert str(problem.reason) == "5 elements of VT_UI1 declared, but there are bytes for 3"
    (problem,) = read(b"??" + bytes.fromhex("0E000000 0800 01000000 08000000 6100"), pos=2).problems
    assert str(problem.reason) == "a string of 8 bytes declared, but there are 2"


def test_a_wrong_length_says_what_the_value_takes() -> None:
    (problem,) = read(b"??" + bytes.fromhex("09000000 0300 01000000 07000000"), pos=2).problems
    assert str(problem.reason) == "argument length is 9, but type and value take 10"


def test_an_unknown_type_is_named() -> None:
    (problem,) = read(bytes.fromhex("08000000 0920 01000000 6162")).problems
    assert str(problem.reason) == "VT_0x0009|VT_ARRAY is not a type that b-CAP carries"


UNKNOWN = "0900 01000000"


@pytest.mark.parametrize(
    ("raw", "problems"),
    [
        (f"06000000 {UNKNOWN}", [(4, "type"), (10, "argc")]),
        (f"05000000 {UNKNOWN} 06000000 {UNKNOWN}", [(4, "type")]),
        (f"07000000 {UNKNOWN}", [(4, "type")]),
        (
            f"08000000 0700 02000000 {'00' * 8} 06000000 {UNKNOWN}",
            [(6, "count"), (0, "argument-length"), (22, "type")],
        ),
    ],
)
def test_an_unknown_type_is_passed_over_if_its_length_can_be_right(
    raw: str, problems: list[tuple[int, str]]
) -> None:
    assert [(each.offset, each.code) for each in read(bytes.fromhex(raw), argc=2).problems] == problems


def test_nesting_is_followed_to_its_bound() -> None:
    assert read(nested(MAX_NESTING), pos=15).problems == []
    deeper = read(nested(MAX_NESTING + 1), pos=15)
    assert [problem.code for problem in deeper.problems] == ["nesting"]
    assert deeper.problems[0].offset == 15 + 4 + 6 * (MAX_NESTING + 1)
    assert [problem.code for problem in read(nested(100_000), pos=15).problems] == ["nesting"]


def test_arguments_that_claim_all_that_follows_are_not_given_it() -> None:
    """Else 64 KiB of such arguments, each holding the rest of the frame, would fill the memory."""
    claims = bytes.fromhex("08000000 1120 FFFFFFFF 6162") * 1000
    reader = read(claims, argc=1000)
    assert [argument.variant.value for argument in reader.arguments] == [b"ab"] * 1000
    check_arguments(tuple(Argument(v, a + 15, o + 15) for v, a, o in reader.arguments), len(claims) + 15)


def test_arguments_that_read_on_to_the_end_are_looked_at_twice_at_most() -> None:
    """Each of these string arrays, taken at its word, reads all others as its strings."""
    crafted = bytes.fromhex("0E000000 0820 FFFFFFFF 00000000 00000000") * 500
    reader = read(crafted, argc=500)
    assert {argument.variant.value for argument in reader.arguments} == {("", "")}
    assert len(reader.arguments) == 500
    assert len(reader.problems) == 101
    assert reader.problems[-1].code == "more"


NUMBERS = Variant.array(VT.I2, (1, 2, 3))
NEST = Variant.array(VT.VARIANT, (NUMBERS, Variant(VT.I4, 5), Variant.array(VT.BSTR, ("a", "b"))))
NEST_BYTES = encode_argument(NEST)


@pytest.mark.parametrize(
    ("values", "numbers", "read"),
    [
        (6, 3, NEST),
        (5, 3, NEST._replace(value=(NUMBERS, Variant(VT.I4, 5), Variant.array(VT.BSTR, ("a",))))),
        (6, 2, NEST._replace(value=(NUMBERS._replace(value=(1, 2)),))),
        (3, 3, NEST._replace(value=(NUMBERS, Variant(VT.I4, 5)))),
        (1, 3, NEST._replace(value=())),
        (0, 3, None),
    ],
)
def test_what_exceeds_the_budget_is_not_read(
    values: int, numbers: int, read: Variant | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arguments_module, "MAX_VALUES", values)
    monkeypatch.setattr(arguments_module, "MAX_NUMBERS", numbers)
    reader = ArgumentReader(NEST_BYTES, 0, len(NEST_BYTES))
    reader.read(1)
    found = [without_counts(argument.variant) for argument in reader.arguments]
    assert found == ([] if read is None else [without_counts(read)])
    what = "2 numbers" if numbers == 2 else f"{values} values"
    reason = f"the frame has more than {what}, the rest is not read"
    expected = [] if read is NEST else [("elements", reason)]
    assert [(problem.code, str(problem.reason)) for problem in reader.problems] == expected
    assert reader.is_complete == (read is NEST)


@pytest.mark.parametrize(("elements", "is_read"), [(2047, True), (2048, False)])
def test_an_array_of_2048_items_with_the_argument_itself_is_read(elements: int, is_read: bool) -> None:
    reader = read(encode_argument(Variant.array(VT.VARIANT, (Variant(VT.EMPTY, None),) * elements)))
    assert reader.is_complete is is_read


def without_counts(variant: Variant) -> tuple[object, ...]:
    value = variant.value
    if isinstance(value, tuple):
        return variant.vt, *(without_counts(each) if isinstance(each, Variant) else each for each in value)
    return variant.vt, value


@pytest.mark.parametrize("size", [MAX_NUMBERS, MAX_NUMBERS + 1, 10_000_000])
def test_the_budget_counts_what_is_there_and_not_what_is_promised(size: int) -> None:
    there = min(size, MAX_NUMBERS + 1)
    data = struct.pack("<IHI", 6 + 2 * there, ARRAY | VT.I2, size) + bytes(2 * there)
    reader = read(data, argc=1)
    value = reader.arguments[0].variant.value
    assert isinstance(value, tuple)
    assert len(value) == MAX_NUMBERS
    assert [problem.code for problem in reader.problems] == ([] if size == MAX_NUMBERS else ["elements"])


def test_arguments_behind_one_that_exceeds_the_budget_are_not_read() -> None:
    row = encode_argument(Variant.array(VT.I2, (1,) * MAX_NUMBERS))
    reader = read(row * 3, argc=3)
    assert [len(argument.variant.value) for argument in reader.arguments] == [MAX_NUMBERS, 0]  # type: ignore[arg-type]  # tuples
    assert [(problem.offset, problem.code) for problem in reader.problems] == [(len(row) + 10, "elements")]
    assert reader.pos == 2 * len(row)


def test_bytes_and_characters_do_not_count_as_elements() -> None:
    size = 4 * MAX_NUMBERS
    values = [Variant.array(VT.UI1, bytes(size)), Variant(VT.BSTR, "x" * size)]
    reader = read(b"".join(map(encode_argument, values)), argc=2)
    assert [argument.variant for argument in reader.arguments] == values
    assert reader.problems == []


@given(st.lists(variants(), max_size=4))
def test_what_is_packed_is_read(values: list[Variant]) -> None:
    data = b"".join(map(encode_argument, values))
    reader = read(data, argc=len(values))
    assert repr([argument.variant for argument in reader.arguments]) == repr(
        [bare(value) for value in values]
    )
    assert reader.problems == []
    assert reader.pos == len(data)


@given(st.binary(max_size=200), st.integers(0, 65535))
def test_any_bytes_are_read_in_order_and_within_bounds(data: bytes, argc: int) -> None:
    reader = read(bytes(15) + data, argc, 15)
    check_arguments(tuple(reader.arguments), 15 + len(data))
    assert all(15 <= problem.offset <= 15 + len(data) for problem in reader.problems)
    assert reader.is_complete or reader.problems
