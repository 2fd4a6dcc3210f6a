"""Text that says how bcapscope knows which end of a conversation is the controller."""

from __future__ import annotations

from bcapscope.messages import Message
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.traffic.observation import Conversation, ServerEvidenceKind

_IDS = {
    ServerEvidenceKind.PARTICIPANT: "server-by.participant",
    ServerEvidenceKind.TEXT: "server-by.text",
    ServerEvidenceKind.HANDSHAKE: "server-by.handshake",
    ServerEvidenceKind.GUESS: "server-by.guess",
}


def server_evidence_message(conversation: Conversation) -> Message:
    kind, code = conversation.server_evidence
    if kind is ServerEvidenceKind.RESULT:
        return Message("server-by.result", server=str(conversation.server), code=f"0x{code:08X}")
    if kind is ServerEvidenceKind.CALL:
        return Message("server-by.call", client=str(conversation.client), function=function_name(code))
    if kind is ServerEvidenceKind.PORT:
        return Message("server-by.port", port=conversation.server.port)
    return Message(_IDS[kind])
