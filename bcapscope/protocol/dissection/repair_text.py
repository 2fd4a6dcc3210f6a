"""Describe a frame's damage in a sentence: where bytes were lost, and what the repaired frame calls."""

from __future__ import annotations

from collections.abc import Sequence

from bcapscope.messages import Message
from bcapscope.protocol.codec.arguments import Problem
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.frame_content import HEADER_SIZE
from bcapscope.protocol.codec.variant import ARRAY, Variant, vt_name
from bcapscope.protocol.dissection.frame_field import UNREAD, FrameField, frame_fields
from bcapscope.protocol.dissection.frame_repair import ByteEdit, FrameRepair, find_repair
from bcapscope.protocol.dissection.plausibility import plausible_prefix_length
from bcapscope.protocol.dissection.similar_commands import find_similar_command
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.protocol.text_format import counted

LONGEST_WORD = 60
"""Maximum number of characters of a frame's string that the description quotes."""

_PARTS = {"bytes": "string length", "data": "value", UNREAD: "value", "left over": "next argument"}


def damage_problem(raw: bytes, is_request: bool | None = None) -> Problem | None:
    """Describe the probable damage of a frame or a separate argument, or a misspelt command in a sound frame.

    The problem has the offset of the first damage. Its code is `cut` if only the end is missing, `argument`
    for a sound argument, `name` for an unknown command, otherwise `guess`. Returns None for a sound frame,
    and if no small damage explains the problems. The description escapes unprintable and non-ASCII characters
    in strings of the frame.
    """
    found = find_repair(raw, is_request)
    if found is None:
        return None if is_request is False else _unknown_name(raw)
    if found.is_argument:
        return _about_argument(raw, found)
    if is_request is None:
        size = len(found.raw) + found.missing_at_end
        is_request = plausible_prefix_length(found.raw, size, True) >= plausible_prefix_length(
            found.raw, size, False
        )
    return _Sentence(raw, found, is_request).problem()


def _unknown_name(raw: bytes) -> Problem | None:
    if len(raw) < HEADER_SIZE or Frame(raw).problems:
        return None
    name = find_similar_command(raw)
    if name is None:
        return None
    start = Frame(raw).arguments[1].start
    return _problem(
        start, "name", f"no command {_word(name.name)} is known, {name.catalogue_name} is near to it"
    )


class _Sentence:
    """Describes a repair as text."""

    def __init__(self, raw: bytes, found: FrameRepair, is_request: bool) -> None:
        self._raw = raw
        self._found = found
        self._frame = Frame(found.raw)
        self._is_request = is_request
        self._fields = frame_fields(self._frame, is_request)

    def problem(self) -> Problem:
        edits, missing = self._found.edits, self._found.missing_at_end
        if missing:
            return self._cut(edits, missing)
        if all(len(edit.found) == len(edit.expected) for edit in edits):
            return self._wrong(edits)
        return _problem(edits[0].offset, "guess", f"probably {self._damage(edits)}; {self._then()}")

    def _cut(self, edits: tuple[ByteEdit, ...], missing: int) -> Problem:
        size = len(self._raw)
        inside = self._where(len(self._frame.raw) - 1)
        rest = f"{counted(missing, 'byte')} missing at the end; what is there reads {self._reading()}"
        whole = len(self._frame.raw) + missing
        if not edits:
            return _problem(size, "cut", f"cut after {size} of {whole} bytes, in {inside}; {rest}")
        reason = f"cut after {size} of {whole} bytes, in {inside}; probably {self._damage(edits)}; {rest}"
        return _problem(edits[0].offset, "guess", reason)

    def _wrong(self, edits: tuple[ByteEdit, ...]) -> Problem:
        first = edits[0].offset
        if first == 1:
            claimed = int.from_bytes(edits[0].found, "little")
            text = f"it says {claimed}, there are {len(self._raw)} bytes"
            return _problem(1, "guess", f"probably only the length field is wrong: {text}")
        misread = " and ".join(
            f"{edit.found.hex().upper()} for {edit.expected.hex().upper()} at offset {edit.offset}"
            for edit in edits
        )
        return _problem(
            first, "guess", f"probably misread: {misread}, in {self._where(first)}; {self._then()}"
        )

    def _damage(self, edits: tuple[ByteEdit, ...]) -> str:
        changed = [edit.found + edit.expected for edit in edits]
        noun = "byte" if any(part.strip(b"\0") for part in changed) else "zero byte"
        what = "too many" if edits[0].found else "lost"
        places = ", ".join(map(self._place, edits))
        return f"{counted(sum(map(len, changed)), noun)} {what}: {places}"

    def _place(self, edit: ByteEdit) -> str:
        at = edit.offset + sum(
            len(other.expected) - len(other.found)
            for other in self._found.edits
            if other.offset < edit.offset
        )
        if edit.offset + len(edit.found) == len(self._raw) and edit.found:
            return f"at offset {edit.offset}, behind the frame"
        inside = _innermost(self._fields, at if edit.expected else at - 1)
        here = inside[-1].stop - inside[-1].start + len(edit.found) - len(edit.expected)
        width = inside[-1].stop - inside[-1].start
        bytes_there = f"{here} of {width} bytes there" if edit.expected else f"{here} bytes for {width}"
        return f"at offset {edit.offset} in {_called(inside)} ({bytes_there})"

    def _where(self, at: int) -> str:
        return _called(_innermost(self._fields, at))

    def _then(self) -> str:
        return f"it then reads {self._reading()}"

    def _reading(self) -> str:
        frame = self._frame
        if not self._is_request:
            types = [vt_name(argument.variant.vt) for argument in frame.arguments]
            return ", ".join([hresult_name(frame.code), *types])
        name = function_name(frame.code)
        value = frame.arguments[1].variant.value if len(frame.arguments) > 1 else None
        return f"{name} {_word(value)}" if isinstance(value, str) else name


def _innermost(found: Sequence[FrameField], at: int) -> list[FrameField]:
    """Return the nested fields that contain a byte, outermost first, at most three."""
    around: list[FrameField] = []
    while len(around) < 3:
        inner = next((field for field in found if field.start <= at < field.stop), None)
        if inner is None:
            break
        around.append(inner)
        if isinstance(inner.value, tuple | bytes) and inner.name == "data":
            break
        found = inner.children
    return around


def _called(around: list[FrameField]) -> str:
    name, inner = around[0].name, around[-1].name
    if len(around) == 1:
        return f"the {_PARTS.get(name, name)}"
    return f"the {_PARTS.get(inner, inner)} of {name}"


def _about_argument(raw: bytes, found: FrameRepair) -> Problem:
    variant = _alone(found.raw)
    text = f"an argument of a frame, {_shown(variant)}"
    if not found.edits:
        return _problem(0, "argument", f"no frame, but {text}")
    first = found.edits[0]
    if len(found.edits) == 2:
        moved = f"its last byte, {raw[-1]:02X}, belongs in front"
        return _problem(len(raw) - 1, "guess", f"no frame; probably {text}: {moved}")
    change = "a zero byte too many" if first.found else "a zero byte lost"
    return _problem(first.offset, "guess", f"no frame; probably {text}: {change}, at offset {first.offset}")


def _alone(argument: bytes) -> Variant:
    size = HEADER_SIZE + len(argument) + 1
    head = b"\x01" + size.to_bytes(4, "little") + bytes(8) + b"\x01\0"
    return Frame(head + argument + b"\x04").arguments[0].variant


def _shown(variant: Variant) -> str:
    name, value = vt_name(variant.vt), variant.value
    if variant.vt & ARRAY:
        return f"{name} of {counted(variant.elements, 'element')}"
    if value is None:
        return name
    return f"{name} {_word(value) if isinstance(value, str) else repr(value)}"


def _word(text: str) -> str:
    """Return a frame's string, shortened, with unprintable and non-ASCII characters escaped."""
    short = text[:LONGEST_WORD]
    plain = short.isascii() and short.isprintable() and short and not short.isspace()
    return (short if plain else ascii(short)) + ("…" if len(text) > LONGEST_WORD else "")


def _problem(offset: int, code: str, reason: str) -> Problem:
    return Problem(offset, code, Message.from_table("text", reason))
