"""Makes replies in place of the controller."""

from __future__ import annotations

import struct

from bcapscope.protocol.codec.frame import SMALLEST_FRAME, Frame, Framing, encode_frame
from bcapscope.protocol.retry.reserved_convention import ReplyReserved
from bcapscope.traffic.bounded_dict import BoundedDict
from bcapscope.traffic.call_kind import MAX_CONVERSATIONS
from bcapscope.traffic.observation import Conversation, Direction, Flow

_SERIAL_RESERVED = struct.Struct("<5xHH").unpack_from
_COMPRESSED = {Framing.VERSION_1_ZLIB: Framing.VERSION_1}


def encode_reply(frame: Frame, reserved: int, code: int) -> bytes:
    """Encode a reply with a result code and no value. The reply has the serial and framing of `frame`."""
    framing = _COMPRESSED.get(frame.framing, frame.framing)
    return encode_frame(frame.serial, 1 if framing is Framing.VERSION_1 else reserved, code, framing=framing)


class ReplyFactory:
    """Makes replies with the reserved field that the controller would send.

    In a reply, some controllers repeat the reserved field of the request, and other controllers send 0. A
    reply to a request with a nonzero reserved field shows whether the controller repeats this field. While
    the controller's behaviour is unknown, `make_reply` sets the reserved field to 0, like DENSO's server
    (orin_bcap C/src/bCAPServer/bcap_server.c).
    """

    def __init__(self) -> None:
        self._last_requests: BoundedDict[Conversation, tuple[int, int]] = BoundedDict(MAX_CONVERSATIONS)
        self._reply_reserved: BoundedDict[Conversation, ReplyReserved] = BoundedDict(MAX_CONVERSATIONS)

    def on_message(self, flow: Flow, data: bytes) -> None:
        """Read the reserved field of a request or reply that is forwarded."""
        if len(data) < SMALLEST_FRAME or data[0] != 1:
            return
        numbers: tuple[int, int] = _SERIAL_RESERVED(data)
        conversation = flow.conversation
        if flow.direction is Direction.REQUEST:
            if numbers[1]:
                self._last_requests[conversation] = numbers
            return
        asked = self._last_requests.get(conversation)
        if asked and asked[0] == numbers[0] and numbers[1] in (0, asked[1]):
            found = ReplyReserved.ECHOED if numbers[1] else ReplyReserved.ZERO
            if self._reply_reserved.get(conversation) is not found:
                self._reply_reserved[conversation] = found

    def make_reply(self, conversation: Conversation, request: Frame, code: int) -> bytes:
        echoes = self._reply_reserved.get(conversation) is ReplyReserved.ECHOED
        return encode_reply(request, request.reserved if echoes else 0, code)

    def close_conversation(self, conversation: Conversation) -> None:
        self._last_requests.pop(conversation, None)
        self._reply_reserved.pop(conversation, None)
