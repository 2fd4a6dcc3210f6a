"""Write values as JSON: text is escaped, times are exact, and NaN and infinities are strings."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator

import orjson

from bcapscope.analysis.statistics.distribution_summary import DistributionSummary
from bcapscope.capture.packet import PacketOrigin
from bcapscope.protocol.tables.hresult import hresult_name
from bcapscope.render.timestamp import epoch_text
from bcapscope.traffic.observation import Conversation


def json_text(value: str | None) -> bytes:
    """Escape every non-printable character. A lone surrogate becomes a ``\\u`` escape."""
    if value is None:
        return b"null"
    if value.isprintable():
        return orjson.dumps(value)
    return json.dumps(value).replace("\x7f", "\\u007f").encode("ascii")


def json_number(value: object) -> bytes:
    """Return a number or a tuple of numbers as JSON; NaN and infinities become strings."""
    text = orjson.dumps(value)
    return text if b"null" not in text else orjson.dumps(json_ready(value))


def json_ready(value: object) -> object:
    """Prepare a number or a tuple of numbers for a JSON encoder; NaN and infinities become strings."""
    if isinstance(value, tuple):
        return [json_ready(item) for item in value]
    if not isinstance(value, float) or math.isfinite(value):
        return value
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"


def text_fragment(text: str | None) -> orjson.Fragment:
    return orjson.Fragment(json_text(text))


def time_fragment(time: int) -> orjson.Fragment:
    """Convert a time in ns since 1970 to a JSON number: seconds with nine decimals."""
    return orjson.Fragment(epoch_text(time))


def result_object(code: int | None) -> dict[str, object]:
    return {"hresult": code, "hresult_name": None if code is None else hresult_name(code)}


def conversation_object(conversation: Conversation) -> dict[str, object]:
    return {
        "client": text_fragment(str(conversation.client)),
        "server": text_fragment(str(conversation.server)),
        "transport": conversation.transport,
    }


def packet_objects(
    frames: Iterable[int], origin_of: Callable[[int], PacketOrigin | None]
) -> list[dict[str, object]]:
    """Return the capture and the packet of each frame, except for frames of unknown captures."""
    return [
        {"frame": frame, "file": text_fragment(origin.path), "packet": origin.packet}
        for frame in frames
        if (origin := origin_of(frame)) is not None
    ]


def with_packets(record: bytes, origin_of: Callable[[int], PacketOrigin | None]) -> bytes:
    """Add the member `packets` to a JSON object: the capture and the packet of each frame in the object. The
    names of the members that hold frame numbers end in `frame` or `frames`."""
    frames = sorted(set(_cited_frames(json.loads(record))))  # orjson reads no lone surrogates
    return b'%b,"packets":%b}' % (record[:-1], orjson.dumps(packet_objects(frames, origin_of)))


def _cited_frames(value: object, is_frame: bool = False) -> Iterator[int]:
    if isinstance(value, dict):
        for name, member in value.items():
            yield from _cited_frames(member, name.endswith(("frame", "frames")))
    elif isinstance(value, list):
        for item in value:
            yield from _cited_frames(item, is_frame)
    elif is_frame and isinstance(value, int):
        yield value


PERCENTILES = {
    **{"mean": "mean", "min": "least", "p50": "p50", "p90": "p90", "p99": "p99", "p99.9": "p999"},
    "max": "most",
}


def percentiles_object(found: DistributionSummary) -> dict[str, object]:
    return {name: json_ready(getattr(found, attribute)) for name, attribute in PERCENTILES.items()}
