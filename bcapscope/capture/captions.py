"""What a caption over a hex dump says: who sent the packet."""

from __future__ import annotations

import re

from bcapscope.traffic.observation import Direction

LONGEST_CAPTION = 120
"""Characters of a caption that are kept."""

LONGEST_PARAGRAPH = 500
"""Characters before hex on its line that are looked at."""

_SENTENCE_END = re.compile(r"(?<=[.!?。])\s+")

_CLIENT = r"(?:client|pc|host|tester)"
_SERVER = r"(?:server|controller|robot|rc[789]\w?)"
_ARROW = r"\s*(?:[-=]*>|[\u2190-\u21ff\u27f5-\u27ff]|to(?:\s+the)?\b)\s*"
_ARROWS = (
    (Direction.REQUEST, re.compile(_CLIENT + _ARROW + _SERVER)),
    (Direction.RESPONSE, re.compile(_SERVER + _ARROW + _CLIENT)),
)
_NAMES = (
    (
        Direction.REQUEST,
        re.compile(r"\b(?:tx\d*|sent|send|sending|send_?data|requests?|query|transmit(?:ted)?)\b|送信|要求"),
    ),
    (
        Direction.RESPONSE,
        re.compile(
            r"\b(?:rx\d*|recv|receiv(?:e|ed|ing)|receive_?data|responses?|reply|replies|answer)\b|受信|応答"
        ),
    ),
)


def caption_direction(caption: str) -> Direction | None:
    """Tell who sent what follows, from such as "TX", "RX(Server->Client) #1", "SendData", "受信".

    Of a paragraph its last sentence decides.
    """
    last = _SENTENCE_END.split(caption[-LONGEST_PARAGRAPH:])[-1]
    return _direction_in(last) or _direction_in(caption[-LONGEST_PARAGRAPH:])


def _direction_in(words: str) -> Direction | None:
    words = words.casefold()
    for forms in (_ARROWS, _NAMES):
        said = [direction for direction, form in forms if form.search(words)]
        if said:
            return said[0] if len(said) == 1 else None
    return None


def shorten_caption(words: str) -> str:
    """Shorten a line, or the end of a paragraph, to what names the packet under it."""
    words = words.strip(" \t-*#•:=")
    return words if len(words) <= LONGEST_CAPTION else _SENTENCE_END.split(words)[-1][-LONGEST_CAPTION:]
