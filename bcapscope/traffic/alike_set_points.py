"""Recognise set points that are alike, so that millions of them are not examined one by one."""

from __future__ import annotations

from typing import TypeAlias

from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.frame_content import FrameContent, Framing
from bcapscope.protocol.codec.frame_template import LARGEST_TEMPLATE_FRAME, FrameForm, varying_spans
from bcapscope.protocol.tables.hresult import is_failure
from bcapscope.traffic.call import Call
from bcapscope.traffic.slave_mode_tracker import is_set_point

MAX_KNOWN = 4
"""Forms of set points that are known at a time in one conversation. A client uses one, rarely two."""

MAX_LEARNED = 64
"""Forms that are learnt in one conversation. After that, set points of further forms are not alike."""

_SetPointForm: TypeAlias = tuple[FrameForm, FrameForm]
"""Forms of the request and of the reply."""


class AlikeSetPoints:
    """The current run of alike set points in one conversation.

    A set point belongs to a run if the client sent it once, the controller answered it with S_OK, both frames
    are sound, and they differ from those of the set points before only in serial, reserved and numbers. So
    the robot's handle, the command and the types of all values are the same. A run begins after an accepted
    set point. Any other call of the conversation ends it.
    """

    def __init__(self) -> None:
        self._current: _SetPointForm | None = None
        self._known: list[_SetPointForm] = []
        self._learned = 0

    def continues(self, call: Call) -> bool:
        """Return whether a call belongs to the run."""
        form, reply = self._current, call.reply
        if form is None or reply is None or call.other_frames:
            return False
        request, answer = call.request.item, reply.item
        raw, result = request.raw, answer.raw
        sent, received = form
        # FrameForm.matches, written out twice: the calls cost a quarter of the check.
        return (
            len(raw) == sent.size
            and len(result) == received.size
            and sent.fixed_parts(raw) == sent.expected_parts
            and received.fixed_parts(result) == received.expected_parts
            and request.external_problem is None
            and answer.external_problem is None
            and (request.reserved in (0, request.serial) or call.first_attempt_seen)
        )

    def on_other_call(self, call: Call) -> None:
        """End the run with a call that does not belong to it, or begin a run after it."""
        if not is_set_point(call.kind):
            self._current = None
        elif call.reply is not None:
            code = call.reply.item.code
            if code == 0:
                self._current = self._form_of_set_point(call.request.item, call.reply.item)
            elif is_failure(code):
                self._current = None

    def _form_of_set_point(self, request: Frame, reply: Frame) -> _SetPointForm | None:
        """Return the form of a set point; learn it if it is new."""
        for sent, received in self._known:
            if sent.matches(request.raw) and received.matches(reply.raw):
                return sent, received
        if self._learned >= MAX_LEARNED:
            return None
        self._learned += 1
        forms = _form_of(request), _form_of(reply)
        if forms[0] is None or forms[1] is None:
            return None
        self._known.insert(0, (forms[0], forms[1]))
        del self._known[MAX_KNOWN:]
        return self._known[0]


def _form_of(frame: Frame) -> FrameForm | None:
    """Return the form of a frame; None if the frame is damaged, too large, or not of `Framing.PLAIN`."""
    if len(frame.raw) > LARGEST_TEMPLATE_FRAME or frame.external_problem is not None:
        return None
    content = FrameContent(frame.raw)
    if content.problems or content.framing is not Framing.PLAIN:
        return None
    return FrameForm(frame.raw, varying_spans(content.number_spans, content.arguments))
