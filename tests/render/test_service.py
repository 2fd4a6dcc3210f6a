"""The simulator's log."""

from __future__ import annotations

import pytest

from bcapscope.protocol.variant import EMPTY, VT, Value, Variant
from bcapscope.render import service
from bcapscope.render.meaning import value_text
from bcapscope.render.service import report_line
from bcapscope.simulator.conversation import Report
from bcapscope.simulator.outcome import Answer
from bcapscope.simulator.values import bstr, i4, r8, row

PEER = ("udp", ("10.0.0.2", 50001))


@pytest.mark.parametrize(
    ("report", "words"),
    [
        (Report(1, 2, (), Answer(), 5, 5), "Service_Stop -> S_OK"),
        (
            Report(1, 64, (i4(3), bstr("Motor"), EMPTY), Answer(), 0, 400_000_000),
            "Robot_Execute 3 Motor - -> S_OK 400.0 ms",
        ),
        (
            Report(1, 200, (), Answer(0x80070057), 0, 0),
            "Unknown(200) -> E_INVALIDARG (argument, option or function id is not valid)",
        ),
        (Report(1, 101, (i4(1),), Answer(0, r8(0.5)), 0, 0), "Variable_GetValue 1 -> S_OK 0.5"),
        (
            Report(1, 101, (i4(1),), Answer(0, row(VT.R4, (0.1, -2.0))), 0, 0),
            "Variable_GetValue 1 -> S_OK [0.1, -2.0]",
        ),
        (
            Report(1, 64, (i4(1), Variant.array(VT.UI1, b"\x00\xff")), Answer(), 0, 0),
            "Robot_Execute 1 [00 ff] -> S_OK",
        ),
        (
            Report(1, 72, (Variant.array(VT.VARIANT, (i4(1), row(VT.R8, (0.5,)))),), Answer(), 0, 0),
            "Robot_Move [1, [0.5]] -> S_OK",
        ),
    ],
)
def test_lines(report: Report, words: str) -> None:
    assert report_line(PEER, report).replace('"', "") == f"udp 10.0.0.2:50001 {words}"


def test_an_address_of_ipv6_is_told_from_its_port() -> None:
    line = report_line(("tcp", ("::1", 50001, 0, 0)), Report(1, 2, (), Answer(), 5, 5))
    assert line == "tcp [::1]:50001 Service_Stop -> S_OK"


def test_hostile_values_are_cut_and_escaped() -> None:
    hostile = (bstr("\x1b[31m\n\u202e" + "x" * 500), row(VT.R8, range(300)), Variant(VT.BSTR, "\ud800"))
    line = report_line(PEER, Report(1, 64, hostile, Answer(), 0, 0))
    assert line.isprintable()
    assert len(line) < 300


def test_only_what_is_shown_of_arrays_in_arrays_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[object] = []

    def counted(value: Value, vt: int, longest: int | None) -> str:
        written.append(value)
        return value_text(value, vt, longest)

    monkeypatch.setattr(service, "value_text", counted)
    inner = Variant.array(VT.VARIANT, (i4(7),) * 50)
    outer = Variant.array(VT.VARIANT, (Variant.array(VT.VARIANT, (inner,) * 50),) * 50)
    line = report_line(PEER, Report(1, 72, (outer,), Answer(), 0, 0))
    assert line.endswith(" [[[7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7,… -> S_OK")
    assert len(written) < 100
