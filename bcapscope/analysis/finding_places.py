"""Values for the placeholders of messages about traffic: clients, calls and result codes."""

from __future__ import annotations

from bcapscope.messages.message import PlaceValue
from bcapscope.messages.places import CallPlace, ClientPlace, CodePlace, Moment
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.traffic.call import Call
from bcapscope.traffic.observation import Conversation


def client_place(conversation: Conversation) -> ClientPlace:
    return ClientPlace(str(conversation.client), conversation.transport.value)


def call_place(call: Call) -> CallPlace:
    """Return a value that messages show as `slvMove 250`: the command or function, and the first serial."""
    return CallPlace(_name_of(call), call.request.item.serial, call.number)


def call_places(call: Call) -> dict[str, PlaceValue]:
    return {
        "at": Moment(call.request.time),
        "call": call_place(call),
        "client": client_place(call.conversation),
    }


def attempt_place(call: Call, serial: int) -> CallPlace:
    return CallPlace(_name_of(call), serial, call.number)


def call_name_place(call: Call) -> CallPlace:
    return CallPlace(_name_of(call), None, call.number)


def code_place(code: int) -> CodePlace:
    return CodePlace(code, hresult_name(code), describe_hresult(code).meaning)


def _name_of(call: Call) -> str:
    command = call.kind.command
    return function_name(call.kind.function_id) if command is None else command
