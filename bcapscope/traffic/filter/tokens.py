"""Tokens of a filter expression, and the error that shows where the expression is invalid."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from enum import Enum
from typing import NamedTuple

from bcapscope.errors import InputError
from bcapscope.messages import Message
from bcapscope.protocol.number_parsing import LONGEST_NUMBER
from bcapscope.protocol.text_format import display_width

LONGEST_EXPRESSION = 8192
"""Maximum length of a filter expression in characters. Typical expressions have about 80 characters."""

_SHOWN_AROUND = 60
# maximum length in characters of a word that is compared, because the comparison takes quadratic time
_LONGEST_MISSPELT = 60


class FilterError(InputError):
    """An invalid filter expression. The message has three lines: the reason, the expression and a caret.

    Attributes:
        expression: The whole filter expression.
        position: Index of the invalid character; the length of the expression if it ends too early.
        reason: Reason why the expression is invalid, as one clause.
    """

    def __init__(self, expression: str, position: int, reason: Message) -> None:
        start, stop = max(0, position - _SHOWN_AROUND), position + _SHOWN_AROUND
        before = ("…" if start else "") + _printable(expression[start:position])
        after = _printable(expression[position:stop]) + ("…" if stop < len(expression) else "")
        caret = f"{' ' * display_width(before)}^"
        super().__init__(Message("filter.located", reason=reason, excerpt=f"{before}{after}", caret=caret))
        self.args = expression, position, reason  # the arguments with which pickle calls `__init__`
        self.expression = expression
        self.position = position
        self.reason = reason


def _printable(text: str) -> str:
    """Replace each control character by one character that is safe for a terminal."""
    return "".join(c if c.isprintable() else " " if c.isspace() else "\ufffd" for c in text)


def with_nearest(reason: Message, word: str, candidates: Iterable[str]) -> Message:
    """If a candidate resembles `word`, add a question to `reason`, such as ``did you mean 'retries'?``."""
    if len(word) > _LONGEST_MISSPELT:
        return reason
    by_folded = {candidate.casefold(): candidate for candidate in candidates}
    found = difflib.get_close_matches(word.casefold(), by_folded)
    return Message("input.similar", reason=reason, name=by_folded[found[0]]) if found else reason


class TokenKind(Enum):
    WORD = "word"
    NUMBER = "number"
    TEXT = "text"
    ADDRESS = "address"
    SIGN = "sign"
    END = "end"


class Token(NamedTuple):
    """One token of a filter expression. `text` is without quotes and unit, and its escapes are resolved."""

    kind: TokenKind
    text: str
    start: int
    stop: int
    unit: str = ""

    def is_sign(self, *texts: str) -> bool:
        return self.kind is TokenKind.SIGN and self.text in texts

    def is_word(self, *texts: str) -> bool:
        """Return whether the token is one of these keywords, ignoring case."""
        return self.kind is TokenKind.WORD and self.text.casefold() in texts


_TOKEN = re.compile(
    r"""(?P<space>\s+)
    | (?P<address>\[(?=[0-9A-Fa-f.]*:)[0-9A-Fa-f:.]{2,64}\](?::[0-9]+)? | [0-9]+(?:\.[0-9]+){3}(?::[0-9]+)?)
    | (?P<number>[-+]?(?:0[xX][0-9A-Fa-f]+ | [0-9]+(?:\.[0-9]+)?(?:[eE][-+]?[0-9]{1,3})?))
      (?P<unit>[ ]+(?:[nuµμm]?s)(?!\w)|\w*)
    | (?P<word>[^\W\d][\w.]*)
    | (?P<text>"(?:[^"\\]|\\.)*" | '(?:[^'\\]|\\.)*')
    | (?P<sign>&& | \|\| | [=!<>]= | [<>!~()\[\],])""",
    re.VERBOSE | re.DOTALL,
)
_ESCAPE = re.compile(r"\\(?:x([0-9A-Fa-f]{2})|u([0-9A-Fa-f]{4})|([\\\"'nrt]))")
_ESCAPED = {"n": "\n", "r": "\r", "t": "\t"}
_HINTS = {
    "=": Message("filter.write-equals"),
    "&": Message("filter.write-and"),
    "|": Message("filter.write-or"),
    ":": Message("filter.ipv6-brackets"),
    '"': Message("filter.unclosed"),
    "'": Message("filter.unclosed"),
}


def tokenize(expression: str) -> list[Token]:
    """Split an expression into tokens; the last token has the kind `TokenKind.END`.

    Raises:
        FilterError: The expression is too long, or contains an unexpected character.
    """
    if len(expression) > LONGEST_EXPRESSION:
        raise FilterError(expression, LONGEST_EXPRESSION, Message("input.too-long", limit=LONGEST_EXPRESSION))
    tokens = []
    position = 0
    while position < len(expression):
        match = _TOKEN.match(expression, position)
        if match is None:
            character = expression[position]
            unknown = Message("input.meaningless", text=f"{character!r}")
            raise FilterError(expression, position, _HINTS.get(character, unknown))
        if match["space"] is None:
            tokens.append(_token(expression, match))
        position = match.end()
    tokens.append(Token(TokenKind.END, "", position, position))
    return tokens


def _token(expression: str, match: re.Match[str]) -> Token:
    start, stop = match.span()
    if match["number"]:
        if len(match["number"]) > LONGEST_NUMBER:
            raise FilterError(expression, start, Message("input.long-number", limit=LONGEST_NUMBER))
        return Token(TokenKind.NUMBER, match["number"], start, stop, match["unit"].strip())
    kind = TokenKind(match.lastgroup)
    text = _ESCAPE.sub(_unescape, match[0][1:-1]) if kind is TokenKind.TEXT else match[0]
    return Token(kind, text, start, stop)


def _unescape(match: re.Match[str]) -> str:
    digits = match[1] or match[2]
    return chr(int(digits, 16)) if digits else _ESCAPED.get(match[3], match[3])
