"""Frames as comma-separated values."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec.frame import Frame, Malformed, encode_frame, parse_datagram
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.render.csv_table import COLUMNS, CsvTableRenderer, csv_cell
from bcapscope.traffic.call_kind import CallKind, call_kind_of
from bcapscope.traffic.observation import Direction
from tests.render.scenes import HOSTILE, ROBOT, observe, scenes
from tests.strategies import mutated_frames


def read(row: str) -> dict[str, str]:
    (cells,) = csv.reader(io.StringIO(row, newline=""), strict=True)
    return dict(zip(COLUMNS, cells, strict=True))


def row(
    raw: bytes, direction: Direction = Direction.REQUEST, call_kind: CallKind | None = None
) -> dict[str, str]:
    (item,) = parse_datagram(raw)
    if isinstance(item, Frame) and direction is Direction.REQUEST:
        call_kind = call_kind_of(item)
    return read(CsvTableRenderer().row(observe(item, direction), call_kind))


def test_table_is_as_it_was(golden: Callable[[str, bytes], None]) -> None:
    table = CsvTableRenderer()
    lines = [table.header(), *(table.row(seen, call_kind) for seen, call_kind in scenes())]
    golden("table.csv", "".join(f"{line}\r\n" for line in lines).encode())


def test_header_names_the_columns() -> None:
    assert CsvTableRenderer().header() == ",".join(COLUMNS)


def test_request() -> None:
    found = row(encode_frame(5, 7, 64, (ROBOT, Variant(VT.BSTR, "Motor"), Variant(VT.I2, 1))))
    args = json.loads(found.pop("args"))
    assert args[2] == {"name": "vntParam", "type": "VT_I2", "value": 1}
    assert found == {
        "frame": "1",
        "time": "1700000000.123456000",
        "src": "10.0.0.2:50001",
        "dst": "[fe80::1%eth0]:5007",
        "transport": "udp",
        "kind": "request",
        "length": "66",
        "serial": "5",
        "reserved": "7",
        "function_id": "64",
        "function": "Robot_Execute",
        "command": "Motor",
        "hresult": "",
        "hresult_name": "",
        "problems": "",
        "raw": "",
    }


def test_reply_has_the_function_that_was_asked() -> None:
    found = row(encode_frame(5, 0, 0x83500121), Direction.RESPONSE, CallKind(64, "slvMove"))
    assert (found["function_id"], found["function"], found["command"]) == ("64", "Robot_Execute", "slvMove")
    assert (found["hresult"], found["hresult_name"]) == (str(0x83500121), "0x83500121")
    assert (found["kind"], found["src"]) == ("response", "[fe80::1%eth0]:5007")


def test_reply_to_nothing_seen() -> None:
    found = row(encode_frame(5, 0, 0), Direction.RESPONSE)
    assert (found["function_id"], found["function"], found["command"]) == ("", "", "")
    assert (found["hresult"], found["hresult_name"]) == ("0", "S_OK")


def test_malformed_bytes_keep_their_row() -> None:
    found = row(b"=HELLO")
    assert (found["kind"], found["length"], found["serial"], found["raw"]) == (
        "malformed",
        "6",
        "",
        "3d48454c4c4f",
    )
    assert found["problems"].startswith("soh at 0: ")


def test_damaged_frame_tells_its_problems() -> None:
    found = row(encode_frame(5, 0, 2)[:-1] + b"\x05")
    assert found["problems"] == "eot at 15: last byte is 05, but a frame ends with 04"
    assert found["raw"] == (encode_frame(5, 0, 2)[:-1] + b"\x05").hex()


@pytest.mark.parametrize("first", ["=", "+", "-", "@", "\t", "\r", "＝", "＋", "－", "＠", " =", "\u3000@"])
def test_what_a_spreadsheet_would_compute_is_neutralised(first: str) -> None:
    shown = csv_cell(f"{first}cmd|' /C calc'!A0")
    assert shown.startswith("'")
    found = row(encode_frame(5, 0, 64, (ROBOT, Variant(VT.BSTR, f"{first}1+1"))))
    assert found["command"].startswith("'")


def test_harmless_text_is_left_alone() -> None:
    assert csv_cell("slvMove") == "slvMove"
    assert csv_cell('Motor-1, "on" 軸') == 'Motor-1, "on" 軸'


def test_hostile_strings_stay_on_their_line() -> None:
    for seen, call_kind in scenes():
        assert CsvTableRenderer().row(seen, call_kind).isprintable()
    found = row(encode_frame(5, 0, 64, (ROBOT, Variant(VT.BSTR, HOSTILE))))
    assert json.loads(found["args"])[1]["value"] == HOSTILE


def test_keys_of_the_json_inside_a_string_are_no_keys() -> None:
    text = '","args":["x"],"problems":['
    found = row(encode_frame(5, 0, 64, (ROBOT, Variant(VT.BSTR, text), Variant(VT.BSTR, text))))
    assert [arg["value"] for arg in json.loads(found["args"])] == [1, text, text]


@given(mutated_frames(), st.sampled_from(Direction), st.text())
def test_any_bytes_have_a_row(raw: bytes, direction: Direction, command: str) -> None:
    table = CsvTableRenderer()
    for item in parse_datagram(raw):
        line = table.row(observe(item, direction), CallKind(64, command))
        assert line.isprintable()
        found = read(line)
        if isinstance(item, Malformed):
            assert found["args"] == ""
        else:
            assert len(json.loads(found["args"])) == len(item.arguments)
