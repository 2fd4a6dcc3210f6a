"""A result for people who have to do something about it: code, meaning, level, and what to do."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name, is_failure, level_name
from bcapscope.render.color_palette import PLAIN, Palette


def result_advice(
    code: int, palette: Palette = PLAIN, words: MessageFormatter = ENGLISH_WORDS
) -> Iterator[str]:
    """Write a result as a few lines: what it is, what it means, how bad it is, what to do.

    A success is one line.
    """
    color = palette
    found, name = describe_hresult(code), hresult_name(code)
    digits = f"0x{code & 0xFFFFFFFF:08X}"
    head = name if name == digits else f"{name} {digits}"
    if not is_failure(code):
        yield f"{color.good}{head}{color.reset} {words.text(found.meaning)}"
        return
    yield f"{color.bad}{head}{color.reset} {words.text(found.meaning)}"
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
        yield f"{color.dim}{'; '.join(details)}{color.reset}"
    if found.advice is not None:
        yield words.text(found.advice)
