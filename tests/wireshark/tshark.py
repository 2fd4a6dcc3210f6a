"""Run tshark with the dissector, and read what it shows as `bcapscope decode --json` shows it."""

from __future__ import annotations

import json
import re
import struct
import subprocess
import sys
from collections.abc import Iterator
from math import isfinite
from pathlib import Path
from shutil import which
from typing import Any, TypeAlias
from xml.etree import ElementTree

import pytest

from bcapscope.protocol.codec.variant import ARRAY, NUMBER_FORMATS, VT, vt_name
from tests.cli.run import run

Record: TypeAlias = dict[str, Any]

needs_tshark = pytest.mark.skipif(which("tshark") is None, reason="tshark is not installed")

_NUMBERS = {f"bcap.arg.{vt.name.lower()}": NUMBER_FORMATS[vt] for vt in VT if vt in NUMBER_FORMATS}
_TEXTS = ("kind", "function", "command", "hresult_name", "hresult_text")
_INTEGERS = ("length", "serial", "reserved", "function_id", "hresult")
_LINKS = ("response_in", "response_to", "retry_of")


def write_dissector(folder: Path) -> Path:
    """Write the dissector as a user does, and return its path."""
    script = folder / "bcapscope.lua"
    script.write_text(run("wireshark", "--print").out, encoding="utf-8")
    return script


def tshark(script: Path, capture: Path, *options: str) -> str:
    """Return what tshark prints; an error of the dissector fails the test."""
    argv = ["tshark", "-X", f"lua_script:{script}", "-r", str(capture), *options]
    done = subprocess.run(argv, capture_output=True, check=False)
    text = done.stdout.decode()
    assert "Lua Error" not in text, text[text.find("Lua Error") :][:500]
    assert "Lua" not in done.stderr.decode(), done.stderr.decode()
    return text


def dissected(script: Path, capture: Path, *options: str) -> list[Record]:
    """Return the frames that tshark shows."""
    pdml = ElementTree.fromstring(_without_nonchars(tshark(script, capture, "-T", "pdml", *options)))
    return [
        _record(proto, int(_show(packet, "num")))
        for packet in pdml.iter("packet")
        for proto in packet.iter("proto")
        if proto.get("name") == "bcap"
    ]


def decoded(capture: Path) -> list[Record]:
    """Return the frames that bcapscope shows, as far as tshark can show them."""
    return [_comparable(json.loads(line)) for line in run("decode", "--json", capture).lines]


def _without_nonchars(text: str) -> str:
    """Return a text without the two characters that XML does not allow and tshark prints."""
    return re.sub("[\ufffe\uffff]", "\ufffd", text)


def _show(packet: ElementTree.Element, name: str) -> str:
    return next(each.get("show", "") for each in packet.iter("field") if each.get("name") == name)


def _record(proto: ElementTree.Element, packet: int) -> Record:
    fields = {field.get("name", ""): field for field in proto.findall("field")}
    found: Record = {"packet": packet}
    for name in _TEXTS:
        found[name] = fields[f"bcap.{name}"].get("show") if f"bcap.{name}" in fields else None
    for name in (*_INTEGERS, *_LINKS):
        found[name] = int(fields[f"bcap.{name}"].get("show", ""), 0) if f"bcap.{name}" in fields else None
    found["args"] = [_argument(field) for field in proto.findall("field") if field.get("name") == "bcap.arg"]
    found["problems"] = [
        _problem(field) for field in proto.findall("field") if field.get("name") == "bcap.problems"
    ]
    found["pos"], found["size"] = int(proto.get("pos", "")), int(proto.get("size", ""))
    return found


def _problem(field: ElementTree.Element) -> Record:
    inner = {each.get("name"): each.get("show", "") for each in field.findall("field")}
    return {
        "offset": int(inner["bcap.problem.offset"]),
        "code": inner["bcap.problem.code"],
        "reason": field.get("show"),
    }


def _argument(field: ElementTree.Element) -> Record:
    (name,) = (each.get("show") for each in field.findall("field") if each.get("name") == "bcap.arg.name")
    return {"name": name, **_typed(field)}


def _typed(field: ElementTree.Element) -> Record:
    vt, values = 0, []
    for each in field.findall("field"):
        if each.get("name") == "bcap.arg.type":
            vt = int(each.get("show", ""), 0)
        values += list(_values(each))
    if vt & ~ARRAY == VT.UI1 and vt & ARRAY and not values:
        values = [[]]
    is_list = vt & ARRAY and not (values and isinstance(values[0], list))
    known = vt & ~ARRAY in (
        *NUMBER_FORMATS,
        VT.BSTR,
        VT.EMPTY,
        VT.NULL,
        *([VT.VARIANT] if vt & ARRAY else []),
    )
    if is_list and vt & ~ARRAY in (VT.EMPTY, VT.NULL):
        known = False
    if not known and not values:
        return {"type": vt_name(vt), "value": []}
    return {"type": vt_name(vt), "value": values if is_list else values[0] if values else None}


def _values(field: ElementTree.Element) -> Iterator[object]:
    name, data = field.get("name", ""), bytes.fromhex(field.get("value", ""))
    if name == "bcap.arg.element":
        yield _typed(field)
    elif name in ("bcap.arg.raw", "bcap.arg.bytes"):
        yield list(data)
    elif name == "bcap.arg.bstr":
        text = data[: len(data) & ~1].decode("utf-16-le", "surrogatepass")
        assert field.get("show") == shown_text(text), (field.get("show"), text)
        yield text
    elif name in _NUMBERS:
        (number,) = struct.unpack(f"<{_NUMBERS[name]}", data)
        show = field.get("show", "")
        if isinstance(number, float):
            shown = (
                max(-sys.float_info.max, min(float(show), sys.float_info.max))
                if isfinite(number)
                else float(show)
            )
            assert shown == pytest.approx(number, rel=1e-5, nan_ok=True), show
            yield repr(number)
        elif name == "bcap.arg.bool":
            assert (show in ("1", "True")) is (number != 0), show
            yield number != 0
        else:
            assert int(show, 0) == number
            yield number


def _comparable(record: Record) -> Record:
    kept = {name: record.get(name) for name in ("packet", *_TEXTS, *_INTEGERS)}
    if record["kind"] == "malformed":
        kept["length"] = None
    kept["command"] = shown_text(kept["command"])
    kept["args"] = [_comparable_value(each) for each in record["args"]]
    kept["problems"] = [{**each, "reason": each["reason"]} for each in record["problems"]]
    return kept


def _comparable_value(value: Any) -> Any:
    if isinstance(value, dict):
        is_float = any(name in value["type"] for name in ("VT_R4", "VT_R8", "VT_DATE"))
        inner = _floats(value["value"]) if is_float else _comparable_value(value["value"])
        return {**({"name": value["name"]} if "name" in value else {}), "type": value["type"], "value": inner}
    if isinstance(value, list):
        return [_comparable_value(each) for each in value]
    return value


def _floats(value: Any) -> Any:
    if isinstance(value, list):
        return [_floats(each) for each in value]
    return None if value is None else repr(float(value))


def shown_text(text: str | None) -> str | None:
    """Return how tshark shows a text in PDML: without NUL and lone surrogates, control characters escaped.

    An XML parser reads a line end or a tab in an attribute as a space.
    """
    if text is None:
        return None
    text = text.replace("\0", "\u2400").encode("utf-16-le", "surrogatepass").decode("utf-16-le", "replace")
    text = _without_nonchars(text.replace("\r\n", "\n"))
    return re.sub(
        "[\x01-\x1f\x7f]", lambda found: " " if found[0] in "\t\n\r" else f"\\x{ord(found[0]):x}", text
    )
