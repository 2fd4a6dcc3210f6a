"""Recognise similar set points, so that rules need not examine millions of set points one by one."""

from __future__ import annotations

from bcapscope.protocol.codec.frame_template import FrameTemplate
from bcapscope.protocol.tables.hresult import is_failure
from bcapscope.traffic.call import Call
from bcapscope.traffic.slave_mode_tracker import is_set_point


class AlikeSetPoints:
    """The current series of alike set points in one conversation.

    A series contains only set points that the client sent once and that the controller accepted with S_OK, in
    undamaged frames. The requests in a series differ only in the serial, the reserved field and numbers in
    the arguments. The replies differ only in the serial, the reserved field and numbers in the value.
    After any other set point with S_OK, a new series begins.
    """

    def __init__(self) -> None:
        self._templates: tuple[FrameTemplate, FrameTemplate] | None = None
        """The templates of requests and replies in the current series; None if there is no series."""

    def continues(self, call: Call) -> bool:
        templates, reply = self._templates, call.reply
        if templates is None or reply is None or call.other_frames:
            return False
        request, answer = call.request.item, reply.item
        raw, result = request.raw, answer.raw
        sent, received = templates
        return (
            len(raw) == sent.size
            and len(result) == received.size
            and sent.fixed_parts(raw) == sent.expected_parts
            and received.fixed_parts(result) == received.expected_parts
            and request.external_problem is None
            and answer.external_problem is None
            and call.first_attempt_seen
        )

    def on_other_call(self, call: Call) -> None:
        """Begin a new series if the call is a set point with S_OK. End the series if the call is a failed set
        point, or no set point.
        """
        if not is_set_point(call.kind):
            self._templates = None
        elif call.reply is not None:
            code = call.reply.item.code
            if code == 0:
                sent, received = call.request.item.template_match, call.reply.item.template_match
                self._templates = (sent[0], received[0]) if sent and received else None
            elif is_failure(code):
                self._templates = None
