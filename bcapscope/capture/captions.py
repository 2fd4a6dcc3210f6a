"""The direction of a packet, as stated in the caption above its hex dump."""

from __future__ import annotations

import re

from bcapscope.traffic.observation import Direction

LONGEST_CAPTION = 120
"""Maximum number of characters to keep of a caption."""

LONGEST_PARAGRAPH = 500
"""Number of characters at the end of a paragraph in which to look for a direction."""

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
    """Return the direction that a caption states, such as "TX", "RX(Server->Client) #1", "SendData", "受信".

    The last sentence of a paragraph takes precedence. Returns None if the caption states no direction.
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
    """Return a caption without decoration; for a long paragraph, only the end of its last sentence."""
    words = words.strip(" \t-*#•:=")
    return words if len(words) <= LONGEST_CAPTION else _SENTENCE_END.split(words)[-1][-LONGEST_CAPTION:]
