"""Damage told in a sentence."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.arguments import Problem
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import EMPTY, VT, Variant, encode_argument
from bcapscope.protocol.dissection.repair_text import damage_problem
from tests.damaged import CHANGE_MODE, DONE, GET_MODE, MOVE, MOVED, NUMBER, SOUND, TEXT, without
from tests.samples.problems import problem_of
from tests.strategies import frames, mutated_frames

READS_MOVE = "it then reads Robot_Execute slvMove"
TWO_LOST = (
    "probably 2 zero bytes lost: at offset 12 in the function id (3 of 4 bytes there), "
    "at offset 27 in the value of hRobot (3 of 4 bytes there); "
)


@pytest.mark.parametrize("frame", SOUND)
def test_nothing_is_said_of_a_sound_frame(frame: bytes) -> None:
    assert damage_problem(frame) is None


@pytest.mark.parametrize(
    ("raw", "is_request", "problem"),
    [
        (
            without(DONE, 14),
            False,
            problem_of(
                14,
                "guess",
                "probably 1 zero byte lost: at offset 14 in the argument count (1 of 2 bytes there); "
                "it then reads S_OK",
            ),
        ),
        (
            GET_MODE[:-1] + b"\0\x04",
            True,
            problem_of(
                77,
                "guess",
                "probably 1 zero byte too many: at offset 77 in the string length of vntParam "
                "(5 bytes for 4); it then reads Robot_Execute slvGetMode",
            ),
        ),
        (without(MOVE, 12, 28), True, problem_of(12, "guess", TWO_LOST + READS_MOVE)),
        (
            without(MOVED, 12, 56),
            False,
            problem_of(
                12,
                "guess",
                "probably 2 zero bytes lost: at offset 12 in the HRESULT (3 of 4 bytes there), at offset 55 "
                "in the value of pVal (31 of 32 bytes there); it then reads S_OK, VT_R4|VT_ARRAY",
            ),
        ),
        (
            without(MOVE, 12, 28)[:51],
            True,
            problem_of(
                12,
                "guess",
                "cut after 51 of 100 bytes, in the characters of bstrCommand; " + TWO_LOST + "47 bytes "
                "missing at the end; what is there reads Robot_Execute slvMo",
            ),
        ),
        (
            CHANGE_MODE[:30],
            True,
            problem_of(
                30,
                "cut",
                "cut after 30 of 82 bytes, in the next argument; 52 bytes missing at the end; "
                "what is there reads Robot_Execute",
            ),
        ),
        (
            CHANGE_MODE.replace(b"n\0", b"\x8e\0").replace(b"e\0M", b"\x85\0M"),
            True,
            problem_of(
                55,
                "guess",
                "probably misread: 8E for 6E at offset 55 and 85 for 65 at offset 59, in the characters of "
                "bstrCommand; it then reads Robot_Execute slvChangeMode",
            ),
        ),
        (
            b"\x01\x04\0\0\0" + MOVE[5:],
            True,
            problem_of(1, "guess", "probably only the length field is wrong: it says 4, there are 100 bytes"),
        ),
        (
            DONE + b"\r\n",
            False,
            problem_of(
                16, "guess", "probably 2 bytes too many: at offset 16, behind the frame; it then reads S_OK"
            ),
        ),
        (
            encode_frame(1, 0, 64, (Variant(VT.I4, 1), Variant(VT.BSTR, "slvChnageMode"), EMPTY)),
            True,
            problem_of(29, "name", "no command slvChnageMode is known, slvChangeMode is near to it"),
        ),
        (NUMBER, None, problem_of(0, "argument", "no frame, but an argument of a frame, VT_I4 1")),
        (
            NUMBER[1:] + NUMBER[:1],
            None,
            problem_of(
                13,
                "guess",
                "no frame; probably an argument of a frame, VT_I4 1: its last byte, 0A, belongs in front",
            ),
        ),
        (
            TEXT + b"\0",
            None,
            problem_of(
                40,
                "guess",
                "no frame; probably an argument of a frame, VT_BSTR slvChangeMode: a zero byte too many, "
                "at offset 40",
            ),
        ),
        (
            encode_argument(Variant.array(VT.R4, (1.0, 2.0))),
            None,
            problem_of(0, "argument", "no frame, but an argument of a frame, VT_R4|VT_ARRAY of 2 elements"),
        ),
        (
            encode_argument(EMPTY),
            None,
            problem_of(0, "argument", "no frame, but an argument of a frame, VT_EMPTY"),
        ),
    ],
)
def test_what_is_said(raw: bytes, is_request: bool | None, problem: Problem) -> None:
    assert damage_problem(raw, is_request) == problem


def test_two_surplus_zeros_are_reported_at_both_places() -> None:
    told = damage_problem(CHANGE_MODE[:12] + b"\0" + CHANGE_MODE[12:40] + b"\0" + CHANGE_MODE[40:], True)
    assert told is not None
    assert str(told.reason).startswith(
        "probably 2 zero bytes too many: at offset 13 in the function id (5 bytes for 4)"
    )
    assert "at offset 44 in the string length of bstrCommand (5 bytes for 4)" in str(told.reason)


@pytest.mark.parametrize(("raw", "word"), [(without(MOVE, 12), "slvMove"), (without(MOVED, 12), "S_OK")])
def test_who_sent_it_is_told_by_what_it_reads(raw: bytes, word: str) -> None:
    told = damage_problem(raw)
    assert told == damage_problem(raw, word == "slvMove")
    assert told is not None
    assert word in str(told.reason)


@given(st.binary(max_size=80) | frames() | mutated_frames(), st.sampled_from([True, False, None]))
def test_any_bytes_are_explained_in_plain_characters(raw: bytes, is_request: bool | None) -> None:
    told = damage_problem(raw, is_request)
    if told is not None:
        assert 0 <= told.offset <= len(raw)
        assert str(told.reason).isprintable()
        assert str(told.reason).replace("…", "").isascii()


def test_hostile_strings_are_escaped() -> None:
    raw = encode_argument(Variant(VT.BSTR, "\x1b[2J\u202e" + "x" * 100))
    told = damage_problem(raw)
    assert told is not None
    assert str(told.reason).startswith(r"no frame, but an argument of a frame, VT_BSTR '\x1b[2J\u202exx")
    assert str(told.reason).endswith("x'…")
