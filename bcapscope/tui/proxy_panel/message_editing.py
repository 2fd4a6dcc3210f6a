"""Editing a held message: changes one argument's value, or all bytes."""

from __future__ import annotations

import json
import re

from bcapscope.faults.fault_notation import rewrite_message
from bcapscope.protocol.codec.frame import Frame, parse_datagram
from bcapscope.render.notation_text import untyped_text
from bcapscope.traffic.observation import Flow
from bcapscope.tui.reader_language import label

_HEX = re.compile(r"[0-9A-Fa-f\s]+")
_BARE = re.compile(r'[^\s"]+')


def edited_message(data: bytes, flow: Flow, text: str) -> bytes:
    """Return a held message after an edit.

    Args:
        data: Bytes of the held message.
        flow: Sender and receiver of the held message.
        text: New bytes in hex, or changes in the notation of the fault ``rewrite``: ``set arg[2]=0 serial
            7``.

    Raises:
        ValueError: The edit is invalid or changes nothing; the error text says why.
    """
    if not text.strip():
        raise ValueError(label("proxy.edit.empty"))
    if _HEX.fullmatch(text):
        return _from_hex(text)
    made = rewrite_message(data, flow, text)
    if made == data:
        raise ValueError(label("proxy.edit.same"))
    return made


def _from_hex(text: str) -> bytes:
    try:
        return bytes.fromhex(text)
    except ValueError:
        raise ValueError(label("proxy.edit.hex")) from None


def proposed_edit(data: bytes, offset: int) -> str:
    """Return the text of an edit that sets the argument at a byte offset to its present value.

    If no argument is at the offset, the edit sets the last argument. The result is "" if no argument has a
    text form.
    """
    for item in parse_datagram(data)[:1]:
        if isinstance(item, Frame) and not item.problems:
            return _argument_edit(item, offset)
    return ""


def _argument_edit(frame: Frame, offset: int) -> str:
    numbered = list(enumerate(frame.arguments))
    here = [(index, each) for index, each in numbered if each.start <= offset < each.stop]
    for index, argument in (*here, *reversed(numbered)):
        text = untyped_text(argument.variant)
        if text is not None:
            return f"set arg[{index}]={_typeable_text(text)}"
    return ""


def _typeable_text(text: str) -> str:
    """Return a string argument as the user would type it, with invisible characters escaped."""
    is_plain = text.isprintable()
    return text if is_plain and _BARE.fullmatch(text) else json.dumps(text, ensure_ascii=not is_plain)
