"""Tokens of a filter, and the caret that an error puts under one of them."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.messages.message import foreign_text
from bcapscope.traffic.filter.tokens import FilterError, TokenKind, tokenize, with_nearest

WORD, NUMBER, TEXT = TokenKind.WORD, TokenKind.NUMBER, TokenKind.TEXT
ADDRESS, SIGN = TokenKind.ADDRESS, TokenKind.SIGN


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("", []),
        ("slvMove", [(WORD, "slvMove", "")]),
        ("アーム_1", [(WORD, "アーム_1", "")]),
        ("a.b", [(WORD, "a.b", "")]),
        ("5", [(NUMBER, "5", "")]),
        ("-5.25e-3", [(NUMBER, "-5.25e-3", "")]),
        ("+5", [(NUMBER, "+5", "")]),
        ("0x1F", [(NUMBER, "0x1F", "")]),
        ("5ms", [(NUMBER, "5", "ms")]),
        ("5 ms", [(NUMBER, "5", "ms")]),
        ("5 ms2", [(NUMBER, "5", ""), (WORD, "ms2", "")]),
        ("5 µs)", [(NUMBER, "5", "µs"), (SIGN, ")", "")]),
        ("1e5", [(NUMBER, "1e5", "")]),
        ("1e5555", [(NUMBER, "1e555", "5")]),
        ("600B", [(NUMBER, "600", "B")]),
        ("10.0.0.2", [(ADDRESS, "10.0.0.2", "")]),
        ("10.0.0.2:5007", [(ADDRESS, "10.0.0.2:5007", "")]),
        ("[fe80::1]:5007", [(ADDRESS, "[fe80::1]:5007", "")]),
        ("[::ffff:10.0.0.2]", [(ADDRESS, "[::ffff:10.0.0.2]", "")]),
        ("[12]", [(SIGN, "[", ""), (NUMBER, "12", ""), (SIGN, "]", "")]),
        ("a!=b", [(WORD, "a", ""), (SIGN, "!=", ""), (WORD, "b", "")]),
        ("!a&&b", [(SIGN, "!", ""), (WORD, "a", ""), (SIGN, "&&", ""), (WORD, "b", "")]),
        ("a||b", [(WORD, "a", ""), (SIGN, "||", ""), (WORD, "b", "")]),
        ("<=>=<>", [(SIGN, "<=", ""), (SIGN, ">=", ""), (SIGN, "<", ""), (SIGN, ">", "")]),
        ('"a b"', [(TEXT, "a b", "")]),
        ("'it\"s'", [(TEXT, 'it"s', "")]),
        (r'"a\"b\\c"', [(TEXT, 'a"b\\c', "")]),
        (r"'it\'s'", [(TEXT, "it's", "")]),
        (r'"\n\r\t\x41\u3042\ud800"', [(TEXT, "\n\r\tAあ\ud800", "")]),
        (r'"\d+\.\w\xZZ"', [(TEXT, r"\d+\.\w\xZZ", "")]),
        ('"two\nlines"', [(TEXT, "two\nlines", "")]),
    ],
)
def test_tokens(expression: str, expected: list[tuple[TokenKind, str, str]]) -> None:
    tokens = tokenize(expression)
    assert [(token.kind, token.text, token.unit) for token in tokens[:-1]] == expected
    assert tokens[-1].kind is TokenKind.END
    assert tokens[-1].start == tokens[-1].stop == len(expression)


@given(st.text(st.characters(), max_size=30))
def test_tokens_lie_one_behind_the_other(text: str) -> None:
    expression = "a " + "".join(c for c in text if c.isalnum() or c in " \t()[]<>!~,") + " b"
    try:
        tokens = tokenize(expression)
    except FilterError:
        return
    for token, following in pairwise(tokens):
        assert token.start < token.stop <= following.start


@pytest.mark.parametrize(
    ("expression", "position", "shown"),
    [
        ("serial == x", 10, "why\n  serial == x\n            ^"),
        ("serial ==", 9, "why\n  serial ==\n           ^"),
        ("", 0, "why\n  \n  ^"),
        ('command == "アーム" && x', 20, 'why\n  command == "アーム" && x\n                         ^'),
        ("ｱｰﾑ x", 4, "why\n  ｱｰﾑ x\n      ^"),
        ("e\u0301 x", 3, "why\n  e\u0301 x\n    ^"),
        ("a\n\tb", 3, "why\n  a  b\n     ^"),
        ("a\x1b[31m\u202e\ud800 x", 9, "why\n  a\ufffd[31m\ufffd\ufffd x\n           ^"),
        ("!" + "b" * 59, 0, f"why\n  !{'b' * 59}\n  ^"),
        ("a" * 100 + "!" + "b" * 100, 100, f"why\n  …{'a' * 60}!{'b' * 59}…\n  {' ' * 61}^"),
    ],
)
def test_the_caret_stands_under_the_spot(expression: str, position: int, shown: str) -> None:
    assert str(FilterError(expression, position, foreign_text("why"))) == shown


def test_nearest_name() -> None:
    def found(word: str, *candidates: str) -> str:
        return str(with_nearest(foreign_text("why"), word, candidates))

    assert found("latncy", "latency", "rtt") == "why, did you mean 'latency'?"
    assert found("ROBOT_EXCEUTE", "Robot_Execute", "Robot_Move") == "why, did you mean 'Robot_Execute'?"
    assert found("zzz", "latency", "rtt") == "why"
    assert found("x" * 60, "X" * 60) == f"why, did you mean '{'X' * 60}'?"
    assert found("x" * 61, "X" * 61) == "why"
