"""Frames that DENSO's own libraries made or read: the same bytes out, the same values in.

In the vectors non-finite numbers and -0.0 stand as texts, UI1 arrays as lists of numbers; an EMPTY or NULL
may have no value at all.
"""

from __future__ import annotations

import json
from typing import Any

import pytest

from bcapscope.protocol.codec.frame import Frame, Framing, encode_frame, parse_datagram
from bcapscope.protocol.codec.stream_splitter import StreamSplitter
from bcapscope.protocol.codec.variant import ARRAY, VT, Value, Variant, vt_name
from tests.shared_folder import SHARED

pytestmark = pytest.mark.interop

VECTORS = SHARED / "vectors.json"

if not VECTORS.exists():
    pytest.skip(f"{VECTORS} is missing: frames of DENSO's libraries", allow_module_level=True)

VECTOR_LIST: list[dict[str, Any]] = json.loads(VECTORS.read_text())


def plain(value: Any) -> Any:
    """Turn a number written as a text into the number; leave other values as they are."""
    return float(value) if isinstance(value, str) else value


def variant_of(described: dict[str, Any]) -> Variant:
    """Build the VARIANT that a vector describes."""
    vt, value = described["type"], described.get("value")
    return Variant(vt, _value(vt, value), described["count"])


def _value(vt: int, value: Any) -> Value:
    base = vt & ~ARRAY
    if not vt & ARRAY:
        return value if base == VT.BSTR else plain(value)  # type: ignore[no-any-return]
    if base == VT.UI1:
        return bytes(value)
    if base == VT.VARIANT:
        return tuple(map(variant_of, value))
    return tuple(value) if base == VT.BSTR else tuple(map(plain, value))


def framing_of(vector: dict[str, Any]) -> Framing:
    """A vector of a serial line has a CRC; all others are plain."""
    return Framing.SERIAL_LINE if vector["transport"] == "com" else Framing.PLAIN


def code_of(vector: dict[str, Any]) -> int:
    """What stands at offset 9: the function of a request, the result of a reply."""
    return vector["function_id"] if vector["direction"] == "request" else int(vector["hresult"], 16)


@pytest.fixture(params=VECTOR_LIST, ids=lambda vector: str(vector["name"]))
def vector(request: pytest.FixtureRequest) -> dict[str, Any]:
    found: dict[str, Any] = request.param
    return found


def test_is_packed_to_the_same_bytes(vector: dict[str, Any]) -> None:
    arguments = list(map(variant_of, vector["args"]))
    made = encode_frame(vector["serial"], vector["reserved"], code_of(vector), arguments, framing_of(vector))
    assert made.hex() == vector["hex"]


@pytest.mark.parametrize("_", ["in full", "by its layout"])
def test_is_read_to_the_same_values(vector: dict[str, Any], _: str) -> None:
    (frame,) = parse_datagram(bytes.fromhex(vector["hex"]))
    assert isinstance(frame, Frame)
    assert frame.problems == ()
    assert frame.framing is framing_of(vector)
    assert (frame.serial, frame.reserved, frame.code) == (
        vector["serial"],
        vector["reserved"],
        code_of(vector),
    )
    expected = list(map(variant_of, vector["args"]))
    assert repr([argument.variant for argument in frame.arguments]) == repr(expected)
    assert [vt_name(argument.variant.vt) for argument in frame.arguments] == [a["vt"] for a in vector["args"]]
    assert (frame.template_match is None) is (frame.framing is Framing.SERIAL_LINE)


def test_all_are_cut_out_of_one_stream() -> None:
    frames = [bytes.fromhex(vector["hex"]) for vector in VECTOR_LIST]
    stream = b"".join(frames)
    for step in (len(stream), 1460, 1):
        splitter = StreamSplitter()
        pieces = [p for at in range(0, len(stream), step) for p in splitter.feed(stream[at : at + step])]
        assert [piece.item.raw for piece in pieces + splitter.close()] == frames
