"""Recognise set points that are alike, so that millions of them are not examined one by one."""

from __future__ import annotations

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.frame_content import FrameContent, Framing
from bcapscope.protocol.codec.frame_template import LARGEST_TEMPLATE_FRAME, FrameMask, varying_spans
from bcapscope.protocol.tables.hresult import is_failure
from bcapscope.traffic.call import Call
from bcapscope.traffic.slave_mode_tracker import is_set_point

MAX_FORMS = 4
"""Forms of set points that one conversation has at a time. A client uses one, rarely two."""

MAX_LEARNED = 64
"""Forms that are learnt in one conversation. After that, set points of further forms are not alike."""

_number = int.from_bytes


class AlikeSetPoints:
    """The current run of set points in one conversation.

    A set point belongs to a run if the client sent it once, the controller answered it with S_OK, both frames
    are sound, and they differ from those of an earlier set point only in serial, reserved and numbers. So the
    robot's handle, the command and the types of all values are the same. A run begins after an accepted set
    point. Any other call of the conversation ends it.
    """

    __slots__ = ("_forms", "_is_on", "_learned")

    def __init__(self) -> None:
        self._is_on = False
        self._forms: list[tuple[FrameMask, FrameMask]] = []
        self._learned = 0

    def continues(self, call: Call) -> bool:
        """Return whether a call belongs to the run."""
        if not self._is_on:
            return False
        reply = call.reply
        if reply is None or call.other_frames:
            return False
        request, answer = call.request.item, reply.item
        if request.external_problem is not None or answer.external_problem is not None:
            return False
        reserved = request.reserved
        if reserved and reserved != request.serial and not call.first_attempt_seen:
            return False
        raw, result = request.raw, answer.raw
        for sent, received in self._forms:
            # FrameMask.matches, written out twice: the calls cost a quarter of the check.
            if (
                len(raw) == sent.size
                and len(result) == received.size
                and _number(raw, "little") & sent.mask == sent.fixed
                and _number(result, "little") & received.mask == received.fixed
            ):
                return True
        return False

    def on_other_call(self, call: Call) -> None:
        """End the run with a call that does not belong to it, or begin a run after it."""
        if not is_set_point(call.kind):
            self._is_on = False
        elif call.reply is not None:
            code = call.reply.item.code
            self._is_on = not is_failure(code)
            if code == 0:
                self._learn(call.request.item, call.reply.item)

    def _learn(self, request: Frame, reply: Frame) -> None:
        """Learn the form of a set point, unless it is known."""
        if self._learned >= MAX_LEARNED or any(
            known.matches(request.raw) and answer.matches(reply.raw) for known, answer in self._forms
        ):
            return
        self._learned += 1
        masks = _mask_of(request), _mask_of(reply)
        if masks[0] is not None and masks[1] is not None:
            self._forms.insert(0, (masks[0], masks[1]))
            del self._forms[MAX_FORMS:]


def _mask_of(frame: Frame) -> FrameMask | None:
    """Return the mask of a frame; None if the frame has problems, is large, or is not framed plainly."""
    if len(frame.raw) > LARGEST_TEMPLATE_FRAME or frame.external_problem is not None:
        return None
    content = FrameContent(frame.raw)
    if content.problems or content.framing is not Framing.PLAIN:
        return None
    return FrameMask(frame.raw, varying_spans(content.number_spans, content.arguments))
