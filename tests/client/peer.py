"""A server that answers every function with something of the right type, and remembers what it was asked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame, parse_datagram
from bcapscope.protocol.codec.stream_splitter import StreamSplitter
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.responder import RequestKind, Responder
from bcapscope.protocol.tables.function_table import FUNCTIONS, ResultKind, function_name
from bcapscope.protocol.tables.hresult import S_OK
from tests.memory_link import MemoryLink

Answer: TypeAlias = tuple[int, Sequence[Variant]]

RESULTS: dict[ResultKind, Variant] = {
    ResultKind.I4: Variant(VT.I4, 5),
    ResultKind.BSTR: Variant(VT.BSTR, "text"),
    ResultKind.VARIANT: Variant.array(VT.R8, (1.0, 2.0)),
    ResultKind.NAMES: Variant.array(VT.BSTR, ("a", "b")),
    ResultKind.DATE: Variant(VT.DATE, 25569.5),
}


class Peer:
    """The server's end of a memory link.

    Attributes:
        executed: function name and values of the arguments of every call, in order.
        answers: what to answer to a function instead of success; None for no answer at all.
    """

    def __init__(self, link: MemoryLink) -> None:
        link.receiver = self
        self._link = link
        self._responder = Responder(expects_retries=link.datagrams)
        self._splitter = StreamSplitter()
        self._handles = 100
        self.executed: list[tuple[object, ...]] = []
        self.answers: dict[str, Answer | None] = {}

    @property
    def functions(self) -> list[object]:
        """Names of the functions that were executed."""
        return [call[0] for call in self.executed]

    def on_data(self, data: bytes) -> None:
        if self._link.datagrams:
            items = list(parse_datagram(data))
        else:
            items = [piece.item for piece in self._splitter.feed(data)]
        for item in items:
            assert isinstance(item, Frame)
            decision = self._responder.receive_request(item)
            if decision.reply is not None:
                self._link.send(decision.reply)
            elif decision.kind is RequestKind.NEW:
                self._execute(item)

    def on_send_error(self, reason: Message) -> None:
        raise AssertionError(reason)

    def on_link_lost(self, reason: Message) -> None:
        self.executed.append(("lost", str(reason)))

    def end(self) -> None:
        """End the call that is being executed without sending its answer."""
        self._responder.answer_call(S_OK)

    def _execute(self, frame: Frame) -> None:
        name = function_name(frame.code)
        self.executed.append((name, *(argument.variant.value for argument in frame.arguments)))
        answer = self.answers.get(name, self._success(frame.code))
        if answer is not None:
            self._link.send(self._responder.answer_call(*answer))

    def _success(self, function_id: int) -> Answer:
        kind = FUNCTIONS[function_id].result
        if kind is ResultKind.NONE:
            return S_OK, ()
        if kind is ResultKind.HANDLE:
            self._handles += 1
            return S_OK, (Variant(VT.I4, self._handles),)
        return S_OK, (RESULTS[kind],)
