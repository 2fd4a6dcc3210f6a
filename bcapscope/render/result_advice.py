"""Write a result code as text: in a few words, or in several lines with advice."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.protocol.tables.hresult import (
    S_EXECUTING,
    describe_hresult,
    hresult_name,
    is_failure,
    level_name,
)
from bcapscope.render.color_palette import PLAIN, Palette


def result_text(code: int, palette: Palette = PLAIN, words: MessageFormatter = ENGLISH_WORDS) -> str:
    """Return the name of a result code, coloured as success or failure, and the meaning of a failure."""
    name = hresult_name(code)
    if is_failure(code):
        return f"{palette.bad}{name} ({words.text(describe_hresult(code).meaning)}){palette.reset}"
    return f"{palette.dim if code == S_EXECUTING else palette.good}{name}{palette.reset}"


def result_advice(
    code: int, palette: Palette = PLAIN, words: MessageFormatter = ENGLISH_WORDS
) -> Iterator[str]:
    """Yield a line that explains a result code. For a failure, add lines with the error level and advice."""
    found, name = describe_hresult(code), hresult_name(code)
    digits = f"0x{code & 0xFFFFFFFF:08X}"
    head = name if name == digits else f"{name} {digits}"
    shade = palette.bad if is_failure(code) else palette.good
    yield f"{shade}{head}{palette.reset} {words.text(found.meaning)}"
    if not is_failure(code):
        return
    details = []
    if found.level is not None:
        details.append(words("hresult.level", level=found.level, name=level_name(found.level)))
    if found.subsystem is not None:
        details.append(words.text(found.subsystem))
    if found.rc7 is not None:
        details.append(f"RC7: {found.rc7}")
    if found.is_guess:
        details.append(words("hresult.guess"))
    if details:
        yield f"{palette.dim}{'; '.join(details)}{palette.reset}"
    if found.advice is not None:
        yield words.text(found.advice)
