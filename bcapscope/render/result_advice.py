"""A result for people who have to do something about it: code, meaning, level, and what to do."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.protocol.tables.hresult import LEVELS, describe_hresult, hresult_name, is_failure
from bcapscope.render.color_palette import PLAIN, Palette
from bcapscope.render.tongue import Tongue, english


def result_advice(code: int, palette: Palette = PLAIN, tongue: Tongue = english) -> Iterator[str]:
    """Write a result as a few lines: what it is, what it means, how bad it is, what to do.

    A success is one line.
    """
    color = palette
    found, name = describe_hresult(code), hresult_name(code)
    digits = f"0x{code & 0xFFFFFFFF:08X}"
    head = name if name == digits else f"{name} {digits}"
    if not is_failure(code):
        yield f"{color.good}{head}{color.reset} {tongue(found.text)}"
        return
    yield f"{color.bad}{head}{color.reset} {tongue(found.text)}"
    details = []
    if found.level is not None:
        details.append(f"{tongue(f'level {found.level}')}, {tongue(LEVELS[found.level])}")
    if found.subsystem is not None:
        details.append(tongue(found.subsystem))
    if found.rc7 is not None:
        details.append(f"RC7: {found.rc7}")
    if found.is_guess:
        details.append(tongue("the meaning is a guess"))
    if details:
        yield f"{color.dim}{'; '.join(details)}{color.reset}"
    if found.advice is not None:
        yield tongue(found.advice)
