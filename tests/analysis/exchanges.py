"""Settled calls made without any traffic, for what only counts them."""

from __future__ import annotations

from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.traffic.call import Call, CallFrame, FrameObservation, FrameRole
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import (
    SERVER_PORT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    Transport,
)
from bcapscope.traffic.reserved_field import ReservedFieldUsage

MS = 1_000_000
START = 1_700_000_000_000_000_000
SERVER = Endpoint("10.0.0.1", 5007)
EXECUTE = 64


def client(port: int = 50001) -> Conversation:
    return Conversation(Endpoint("10.0.0.2", port), SERVER, Transport.UDP, SERVER_PORT)


CLIENT = client()
MOVE = CallKind(EXECUTE, "slvMove")
READ = CallKind(EXECUTE, "CurJnt")
STOP = CallKind(2, None)


def made(
    ms: float,
    latency: float | None,
    question: CallKind = MOVE,
    conversation: Conversation = CLIENT,
    *,
    code: int = 0,
    retries: int = 0,
    late: int = 0,
    notices: int = 0,
    given_up: bool = True,
    call: int = 1,
) -> Call:
    """Make a call that began at `ms` and was answered `latency` ms later, or never.

    Retries follow every millisecond; a call without a reply is given up or, if not, cut off by the end.
    """
    time = START + round(ms * MS)

    def see(after: float, direction: Direction, serial: int, reserved: int, what: int) -> FrameObservation:
        arguments = (
            () if question.command is None else (Variant(VT.I4, 1), Variant(VT.BSTR, question.command))
        )
        raw = encode_frame(serial, reserved, what, arguments if direction is Direction.REQUEST else ())
        moment = time + round(after * MS)
        seen: FrameObservation = Observation(1, moment, moment, Flow(conversation, direction), Frame(raw), 1)  # type: ignore[assignment]  # item is a frame
        return seen

    request = see(0, Direction.REQUEST, 10, 0, question.function_id)
    exchange = Call(call, conversation, question, request, ReservedFieldUsage())
    tries = [see(n, Direction.REQUEST, 10 + n, 10, question.function_id) for n in range(1, retries + 1)]
    exchange.other_frames = [
        *(CallFrame(FrameRole.RETRY, seen) for seen in tries),
        *(
            CallFrame(FrameRole.LATE, see(retries + 0.1, Direction.RESPONSE, 10, 0, code))
            for _ in range(late)
        ),
        *(CallFrame(FrameRole.NOTICE, see(0.5, Direction.RESPONSE, 10, 0, 0x900)) for _ in range(notices)),
    ]
    if latency is not None:
        exchange.reply = see(latency, Direction.RESPONSE, 10 + retries, 0, code)
        exchange.last_activity = exchange.reply.time
    elif given_up:
        exchange.abandoned_at = time + 5 * MS
    return exchange
