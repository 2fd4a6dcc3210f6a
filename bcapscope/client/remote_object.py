"""Base class of the controller's objects: calls a function, and converts the value in the reply."""

from __future__ import annotations

from datetime import datetime
from types import TracebackType
from typing import ClassVar, Self, TypeVar

from bcapscope.client.session import Session
from bcapscope.errors import RemoteProtocolError
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import EMPTY, Value, Variant, vt_name
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.protocol.variant_values import date_of, plain_value

R = TypeVar("R")


def handle_of(reply: Frame) -> int:
    return expect_value(reply, int, "reply.a-handle")


def first_variant(reply: Frame) -> Variant | None:
    arguments = reply.arguments
    return arguments[0].variant if arguments else None


def expect_value(reply: Frame, kind: type[R], wanted: str) -> R:
    """Return the value in a reply, or raise RemoteProtocolError if the value is not of type `kind`.

    `wanted` is the id of a message that names the expected type, such as `reply.a-handle`.
    """
    variant = first_variant(reply)
    if variant is not None and isinstance(variant.value, kind):
        return variant.value
    found = Message("reply.nothing") if variant is None else vt_name(variant.vt)
    raise RemoteProtocolError(Message("reply.wrong-type", found=found, wanted=Message(wanted)), reply.raw)


def required_variant(reply: Frame, name: str) -> Variant:
    """Return the value in a reply. If the reply has no value, raise RemoteProtocolError, whose text contains
    `name`.
    """
    variant = first_variant(reply)
    if variant is None:
        raise RemoteProtocolError(Message("reply.no-value", name=name), reply.raw)
    return variant


class RemoteObject:
    """An object in the controller, with its handle. The end of an `async with` block releases the object.

    `owner` is the class of the object, such as `Robot`. The name of each function of the object begins with
    the name of this class, as in `Robot_Execute`.
    """

    owner: ClassVar[ObjectClass]

    def __init__(self, session: Session, handle: int) -> None:
        self.session = session
        self.handle = handle

    async def release(self) -> None:
        """Release the object. Otherwise, the session releases the object when the session's block ends."""
        await self._invoke("Release")

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.release()

    async def _invoke(self, verb: str, *values: object) -> Frame:
        return await self.session.invoke(f"{self.owner}_{verb}", self.handle, *values)

    async def _invoke_int(self, verb: str) -> int:
        return expect_value(await self._invoke(verb), int, "reply.a-number")

    async def _invoke_text(self, verb: str, *values: object) -> str:
        return expect_value(await self._invoke(verb, *values), str, "reply.a-string")

    async def _invoke_value(self, verb: str, *values: object) -> Value:
        return plain_value(first_variant(await self._invoke(verb, *values)) or EMPTY)

    async def _invoke_names(self, verb: str, option: str) -> tuple[str, ...]:
        reply = await self._invoke(verb, option)
        names = plain_value(first_variant(reply) or EMPTY)
        if names is None:
            return ()
        if isinstance(names, tuple):
            texts = tuple(name for name in names if isinstance(name, str))
            if len(texts) == len(names):
                return texts
        raise RemoteProtocolError(Message("reply.no-names"), reply.raw)

    async def _invoke_date(self, verb: str) -> datetime:
        reply = await self._invoke(verb)
        days = expect_value(reply, float, "reply.a-date")
        date = date_of(days)
        if date is None:
            raise RemoteProtocolError(Message("reply.impossible-date", days=days), reply.raw)
        return date

    async def _invoke_handle(self, verb: str, *values: object) -> int:
        return handle_of(await self._invoke(verb, *values))
