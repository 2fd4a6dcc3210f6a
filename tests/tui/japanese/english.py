"""English that is left in a Japanese sentence."""

from __future__ import annotations

import re

_WORD = re.compile(r"(?<![\w.,'@|（(=/-])[a-z]{2,}(?![\w'=/([-])")
_TERMS = frozenset(("deg", "loss", "mm", "ms", "ppm", "rad", "reserved", "tcp", "udp", "us", "zlib"))
"""Units and words of the vendor's, the same in Japanese."""

_NAME = re.compile("「[^」]*」|x{60}…")
"""What is from the wire or a file."""


def left_over(japanese: str) -> list[str]:
    """List the English words in a sentence that should have none."""
    return [word for word in _WORD.findall(_NAME.sub("", japanese)) if word not in _TERMS]
