"""The simulator's log."""

from __future__ import annotations

import pytest

from bcapscope.protocol.codec.variant import EMPTY, VT, Value, Variant
from bcapscope.render import simulator_log
from bcapscope.render.simulator_log import call_log_line
from bcapscope.render.value_text import value_text
from bcapscope.simulator.argument_values import bstr, float_array, i4, r8
from bcapscope.simulator.call_executor import CallReport
from bcapscope.simulator.call_outcome import CallResult

PEER = ("udp", ("10.0.0.2", 50001))


@pytest.mark.parametrize(
    ("report", "words"),
    [
        (CallReport(1, 2, (), CallResult(), 5, 5), "Service_Stop -> S_OK"),
        (
            CallReport(1, 64, (i4(3), bstr("Motor"), EMPTY), CallResult(), 0, 400_000_000),
            "Robot_Execute 3 Motor - -> S_OK 400.0 ms",
        ),
        (
            CallReport(1, 200, (), CallResult(0x80070057), 0, 0),
            "Unknown(200) -> E_INVALIDARG (argument, option or function id is not valid)",
        ),
        (CallReport(1, 101, (i4(1),), CallResult(0, r8(0.5)), 0, 0), "Variable_GetValue 1 -> S_OK 0.5"),
        (
            CallReport(1, 101, (i4(1),), CallResult(0, float_array(VT.R4, (0.1, -2.0))), 0, 0),
            "Variable_GetValue 1 -> S_OK [0.1, -2.0]",
        ),
        (
            CallReport(1, 64, (i4(1), Variant.array(VT.UI1, b"\x00\xff")), CallResult(), 0, 0),
            "Robot_Execute 1 [00 ff] -> S_OK",
        ),
        (
            CallReport(
                1, 72, (Variant.array(VT.VARIANT, (i4(1), float_array(VT.R8, (0.5,)))),), CallResult(), 0, 0
            ),
            "Robot_Move [1, [0.5]] -> S_OK",
        ),
    ],
)
def test_lines(report: CallReport, words: str) -> None:
    assert call_log_line(PEER, report).replace('"', "") == f"udp 10.0.0.2:50001 {words}"


def test_an_address_of_ipv6_is_told_from_its_port() -> None:
    line = call_log_line(("tcp", ("::1", 50001, 0, 0)), CallReport(1, 2, (), CallResult(), 5, 5))
    assert line == "tcp [::1]:50001 Service_Stop -> S_OK"


def test_hostile_values_are_cut_and_escaped() -> None:
    hostile = (
        bstr("\x1b[31m\n\u202e" + "x" * 500),
        float_array(VT.R8, range(300)),
        Variant(VT.BSTR, "\ud800"),
    )
    line = call_log_line(PEER, CallReport(1, 64, hostile, CallResult(), 0, 0))
    assert line.isprintable()
    assert len(line) < 300


def test_only_what_is_shown_of_arrays_in_arrays_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[object] = []

    def counted(value: Value, vt: int, longest: int | None) -> str:
        written.append(value)
        return value_text(value, vt, longest)

    monkeypatch.setattr(simulator_log, "value_text", counted)
    inner = Variant.array(VT.VARIANT, (i4(7),) * 50)
    outer = Variant.array(VT.VARIANT, (Variant.array(VT.VARIANT, (inner,) * 50),) * 50)
    line = call_log_line(PEER, CallReport(1, 72, (outer,), CallResult(), 0, 0))
    assert line.endswith(" [[[7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7, 7,… -> S_OK")
    assert len(written) < 100
