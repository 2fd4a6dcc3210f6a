"""Encode messages as JSON, to send them to the process that shows them in the reader's language."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import cast

import orjson

from bcapscope.messages import places
from bcapscope.messages.message import Json, Message, Place, PlaceValue

_PLACE_TYPES: dict[str, type[Place]] = {
    each.type_name: each
    for each in vars(places).values()
    if isinstance(each, type) and issubclass(each, Place) and each is not Place
}


def message_to_data(message: Message) -> dict[str, Json]:
    data: dict[str, Json] = {"id": message.id}
    if message.places:
        data["places"] = {name: _to_data(value) for name, value in message.places.items()}
    if message.english is not None:
        data["english"] = message.english
    return data


def message_from_data(data: Mapping[str, Json]) -> Message:
    """Raises KeyError, TypeError or AttributeError if the data is not an encoded message."""
    given = cast("Mapping[str, Json]", data.get("places", {}))
    values = {name: cast("PlaceValue", _from_data(value)) for name, value in given.items()}
    id, english = data["id"], data.get("english")
    if not isinstance(id, str) or not isinstance(english, str | None):
        raise TypeError("not an encoded message")
    return Message(id, **values) if english is None else Message.from_table(id, english, **values)


def encode_message(message: Message) -> bytes:
    """Return one line of JSON. Lone surrogates, which UTF-8 cannot encode, become question marks."""
    data = message_to_data(message)
    try:
        return orjson.dumps(data)
    except orjson.JSONEncodeError:
        return json.dumps(data, ensure_ascii=False).encode("utf-8", "replace")


def decode_message(line: bytes) -> Message:
    return message_from_data(orjson.loads(line))


def _to_data(value: object) -> Json:
    if isinstance(value, Message):
        return message_to_data(value)
    if isinstance(value, Place):
        return {"type": value.type_name, "fields": list(map(_to_data, vars(value).values()))}
    if isinstance(value, tuple):
        return [_to_data(each) for each in value]
    return cast("Json", value)


def _from_data(data: Json) -> object:
    if isinstance(data, list):
        return tuple(map(_from_data, data))
    if not isinstance(data, dict):
        return data
    if "id" in data:
        return message_from_data(data)
    kind = _PLACE_TYPES[cast("str", data["type"])]
    return kind(*map(_from_data, cast("list[Json]", data["fields"])))
