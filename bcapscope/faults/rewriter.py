"""Changes numbers in a frame. All other bytes of the message do not change."""

from __future__ import annotations

import math
import operator
import struct
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, TypeAlias, cast

from bcapscope.errors import LocalProtocolError
from bcapscope.faults.quantities import Span, read_path
from bcapscope.protocol.codec.frame import Frame, Framing, encode_frame
from bcapscope.protocol.codec.variant import ARRAY, VT, Variant, vt_name
from bcapscope.protocol.codec.variant_notation import parse_variant_as
from bcapscope.traffic.observation import Conversation, Direction, Flow, Transport

if TYPE_CHECKING:
    from bcapscope.faults.fault_kinds import RewriteFault, RewriteValue

MAX_REMEMBERED = 4096
"""Maximum number of messages that a `Rewriter` keeps; a normal session needs a few dozen."""

MAX_BYTES = 1 << 20
"""Maximum total size in bytes of the messages that a `Rewriter` keeps, after decompression. The decoded
values of a message take up to 100 times as much memory as its bytes.
"""

_Key: TypeAlias = tuple[Conversation, Direction, tuple[int, str | None]]

ValueChange: TypeAlias = Callable[[Variant], Variant]
"""Function that returns the changed value, or the same object if nothing changes."""

NumberChange: TypeAlias = Callable[[float, int], float]
"""Function that gets a number and its array index (0 outside an array), and returns the new number."""


class _LastMessage(NamedTuple):
    """The latest message of a series of similar messages.

    Attributes:
        raw: Bytes of the message as received.
        values: Arguments of the message as forwarded.
        step_base: Latest forwarded value of each argument or element that `step` limits, by its position in
            `step`.
        size: Number of bytes of the frame after decompression.
    """

    raw: bytes
    values: list[Variant]
    step_base: dict[int, Variant]
    size: int


_SERIAL_RESERVED_CODE = struct.Struct("<HHI")
_INTEGERS = frozenset((VT.I2, VT.I4, VT.UI1, VT.UI2, VT.UI4, VT.I8, VT.UI8))
_NUMBERS = _INTEGERS | {VT.R4, VT.R8}


def with_header(
    frame: Frame, *, serial: int | None = None, reserved: int | None = None, code: int | None = None
) -> bytes:
    """Return a frame's bytes with a new serial, reserved field and code; None leaves a field unchanged. If an
    undamaged frame has a checksum or compressed contents, the whole frame is encoded again.
    """
    numbers = (
        frame.serial if serial is None else serial,
        frame.reserved if reserved is None else reserved,
        frame.code if code is None else code,
    )
    if numbers == (frame.serial, frame.reserved, frame.code):
        return frame.raw
    if frame.framing is not Framing.PLAIN and not frame.problems:
        return _encode_or_keep(frame, numbers, frame.variants)
    return frame.raw[:5] + _SERIAL_RESERVED_CODE.pack(*numbers) + frame.raw[13:]


def _encode_or_keep(frame: Frame, numbers: tuple[int, int, int], values: Sequence[Variant]) -> bytes:
    try:
        return encode_frame(*numbers, values, frame.framing)
    # A value does not fit its type, or the new reserved field is not allowed in a version 1 frame.
    except LocalProtocolError:
        return frame.raw


class Rewriter:
    """Applies a `RewriteFault`. To limit steps, the rewriter keeps the latest message of each series of
    similar messages. Similar messages have the same conversation, direction, code and command.
    """

    def __init__(self, fault: RewriteFault) -> None:
        self._fault = fault
        self._set = [(read_path(path), setting) for path, setting in fault.set.items()]
        self._limit = [(read_path(path), span) for path, span in fault.limit.items()]
        self._step = [(read_path(path), step) for path, step in fault.step.items()]
        self._last_messages: dict[_Key, _LastMessage] = {}
        self._size = 0

    def rewrite(self, frame: Frame, flow: Flow) -> bytes:
        """Return the changed bytes of `frame`. In a damaged frame, change only the header."""
        fault = self._fault
        raw = with_header(frame, serial=fault.serial, reserved=fault.reserved, code=fault.code)
        if frame.problems:
            return raw
        before = frame.variants
        values = list(before)
        for path, setting in self._set:
            _edit(values, path, partial(_with_setting, setting=setting))
        for path, span in self._limit:
            _edit(values, path, partial(_clamped, span=span))
        if self._step:
            values = self._stepped(frame, flow, values)
        if all(map(operator.is_, values, before)):
            return raw
        head = Frame(raw)
        return _encode_or_keep(frame, (head.serial, head.reserved, head.code), values)

    def _stepped(self, frame: Frame, flow: Flow, values: list[Variant]) -> list[Variant]:
        """Return `values` with limited steps. The fault's `step` names numbers, and the largest change of
        each. A named number changes by at most this much from the latest similar message as forwarded (see
        `Rewriter`). A retry gets the values of the first attempt: other values would make the controller
        execute a new call.
        """
        key = flow.conversation, flow.direction, _series_key(frame)
        last = self._last_messages.get(key)
        if (
            last is not None
            and flow.conversation.transport is Transport.UDP
            and _is_attempt_of(frame, last.raw)
        ):
            return last.values
        before = {} if last is None else last.step_base
        reached = dict(before)

        def near(value: Variant, index: int, step: float) -> Variant:
            reached[index] = _step_limited(value, before[index], step) if index in before else value
            return reached[index]

        for index, (path, step) in enumerate(self._step):
            _edit(values, path, partial(near, index=index, step=step))
        self._remember(key, _LastMessage(frame.raw, values, reached, len(frame.body)))
        return values

    def _remember(self, key: _Key, last: _LastMessage) -> None:
        known = self._last_messages.pop(key, None)
        self._last_messages[key] = last
        self._size += last.size - (0 if known is None else known.size)
        while len(self._last_messages) > MAX_REMEMBERED or (
            self._size > MAX_BYTES and len(self._last_messages) > 1
        ):
            self._size -= self._last_messages.pop(next(iter(self._last_messages))).size

    def close_conversation(self, conversation: Conversation) -> None:
        self._last_messages = {
            key: value for key, value in self._last_messages.items() if key[0] is not conversation
        }
        self._size = sum(last.size for last in self._last_messages.values())


def _is_attempt_of(frame: Frame, raw: bytes) -> bool:
    is_retry = frame.reserved not in (0, frame.serial)
    return frame.raw == raw or (is_retry and frame.raw[9:] == raw[9:])


def _series_key(frame: Frame) -> tuple[int, str | None]:
    arguments = frame.variants
    command = arguments[1].value if len(arguments) > 1 else None
    return frame.code, command if isinstance(command, str) else None


def _edit(values: list[Variant], path: tuple[int, ...], change: ValueChange) -> None:
    index, *rest = path
    if index < len(values):
        values[index] = _edited(values[index], tuple(rest), change)


def _edited(value: Variant, path: tuple[int, ...], change: ValueChange) -> Variant:
    if not path:
        return change(value)
    elements = _elements(value)
    if path[0] >= len(elements):
        return value
    old = elements[path[0]]
    new = _edited(old, path[1:], change)
    if new is old or (value.vt != ARRAY | VT.VARIANT and new.vt != old.vt):
        return value
    elements[path[0]] = new
    return _with_elements(value, elements)


def _elements(value: Variant) -> list[Variant]:
    """Return the elements of an array, each with its type; [] if the value is not an array."""
    base = value.vt & ~ARRAY
    if not isinstance(value.value, tuple | bytes):
        return []
    if base == VT.VARIANT:
        return [element for element in value.value if isinstance(element, Variant)]
    return [Variant(base, element) for element in value.value]


def _with_elements(value: Variant, elements: list[Variant]) -> Variant:
    base = value.vt & ~ARRAY
    if base == VT.VARIANT:
        return value._replace(value=tuple(elements))
    if base == VT.UI1:
        return value._replace(value=bytes(cast(int, element.value) for element in elements))
    return value._replace(value=tuple(element.value for element in elements))


def _with_setting(value: Variant, setting: RewriteValue) -> Variant:
    """If `setting` names a type, such as `i2:5`, convert `setting` to this type; otherwise, to the type of
    `value`. If `setting` is invalid, return `value`.
    """
    text = str(setting).lower() if isinstance(setting, bool) else str(setting)
    try:
        new = parse_variant_as(text, [vt_name(value.vt)])
    except ValueError:
        return value
    return value if new == value else new


def _clamped(value: Variant, span: Span) -> Variant:
    return _each_number(value, lambda number, index: span.clamp(number))


def _step_limited(value: Variant, last: Variant, step: float) -> Variant:
    elements = _elements(last) or [last]
    around = [element.value for element in elements]

    def near(number: float, index: int) -> float:
        middle = around[index] if index < len(around) else None
        if not isinstance(middle, int | float) or not math.isfinite(middle):
            return number
        return Span(middle - step, middle + step).clamp(number)

    return _each_number(value, near)


def _each_number(value: Variant, change: NumberChange) -> Variant:
    """Change a number, or every number of an array. A value of an integer type stays an integer."""
    elements = _elements(value)
    if not elements:
        return _with_number(value, 0, change)
    new = [_with_number(element, index, change) for index, element in enumerate(elements)]
    if all(map(operator.is_, new, elements)):
        return value
    return _with_elements(value, new)


def _with_number(value: Variant, index: int, change: NumberChange) -> Variant:
    if value.vt not in _NUMBERS:
        return value
    number = cast(float, value.value)
    new = change(number, index)
    if new == number:
        return value
    if value.vt in _INTEGERS:
        new = math.ceil(new) if new > number else math.floor(new)
    return value._replace(value=new)
