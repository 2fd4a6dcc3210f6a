"""Findings, filters and damaged captures, in Japanese."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bcapscope.capture.capture_file import open_capture
from bcapscope.errors import CaptureError
from bcapscope.messages import Language, MessageFormatter
from bcapscope.traffic.call import FrameRole
from bcapscope.traffic.filter.compiler import FilterError, compile_filter
from bcapscope.traffic.filter.field_table import RecordKind
from tests.cli.run import CAPTURES

WORDS = MessageFormatter(Language.JAPANESE)

JAPANESE = re.compile("[ぁ-んァ-ヶ一-龥]")


@pytest.mark.parametrize("role", FrameRole)
def test_what_a_frame_is_to_its_call(role: FrameRole) -> None:
    assert JAPANESE.search(WORDS(f"frame.role.{role.replace(' ', '-')}"))


@pytest.mark.parametrize(
    "expression",
    [
        "serial = 1",
        "serial == 1 & serial == 2",
        "serial == 1 | serial == 2",
        'command == "x',
        "serial ==",
        "serial == 1 and",
        "serial == 1 serial",
        "(serial == 1",
        "seriel == 1",
        "xyzzy == 1",
        "hresult == S_OKK",
        "latency > 5",
        "latency > 5xs",
        "client == nobody",
        'command ~ "("',
        "serial ~ x",
        "serial[0] == 1",
        "==",
        "serial contains 5",
        "command > 5",
        "serial == abc",
        "kind == foo",
        "retries == 1",
        "hresult == 0x1ffffffff",
        "command in x",
        "#",
    ],
)
def test_what_is_wrong_with_a_filter(expression: str) -> None:
    kind = RecordKind.CALL if "latency" in expression else RecordKind.FRAME
    with pytest.raises(FilterError) as raised:
        compile_filter(expression, kind)
    assert JAPANESE.search(WORDS.text(raised.value.reason))


@pytest.mark.parametrize(
    "data",
    [b"", b"no capture at all", b"\xd4\xc3\xb2\xa1", b"PK\x03\x04" * 9, b"\x1f\x8b\x08" + bytes(40)],
    ids=["empty", "text", "header", "zip", "gzip"],
)
def test_what_is_wrong_with_a_capture(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(data)
    with pytest.raises(CaptureError) as raised, open_capture(path) as capture:
        list(capture)
    assert JAPANESE.search(WORDS.text(raised.value.message))


def test_a_capture_that_breaks_off_or_is_not_there(tmp_path: Path) -> None:
    path = tmp_path / "a.pcapng"
    path.write_bytes((CAPTURES / "slave-session.pcapng").read_bytes()[:-10])
    for each in (path, tmp_path / "none"):
        with pytest.raises(CaptureError) as raised, open_capture(each) as capture:
            list(capture)
        assert JAPANESE.search(WORDS.text(raised.value.message))
