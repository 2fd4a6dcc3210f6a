"""Numbers and strings with a meaning."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.tables import enumerations
from bcapscope.protocol.tables.enumerations import (
    option_meanings,
    pass_motion_text,
    provider_meaning,
    result_meanings,
    sys_state_texts,
)


def test_sys_state_names_the_bits() -> None:
    assert sys_state_texts(0) == ()
    assert sys_state_texts(1 << 2 | 1 << 10) == ("servo on", "emergency stop")
    assert sys_state_texts(1 << 9) == ("bit 9",)
    reserved = [bit for bit in range(32) if sys_state_texts(1 << bit) == (f"bit {bit}",)]
    assert reserved == [9, 14, 15, 22, 23, 25, 26, 27, 28, 29, 30, 31]
    assert sys_state_texts(0b1111 << 16) == (
        "program start reset",
        "calibration done",
        "manual mode",
        "one cycle done",
    )


@given(st.integers(-(2**31), 2**31 - 1))
def test_sys_state_names_each_bit_of_any_number_once(value: int) -> None:
    assert len(sys_state_texts(value)) == (value & 0xFFFFFFFF).bit_count() == len(set(sys_state_texts(value)))


def test_providers_in_any_case() -> None:
    assert provider_meaning("caoprov.denso.vrc") == provider_meaning("CaoProv.DENSO.VRC")
    assert "RC9" in (provider_meaning("CaoProv.DENSO.VRC9") or "")
    assert provider_meaning("CaoProv.Nobody") is None


def test_pass_motions() -> None:
    assert [pass_motion_text(value) for value in (-2, -1, 0, 10)] == ["@E", "@P", "@0", "@10"]


def test_keys_of_options() -> None:
    assert option_meanings("", is_move=False) == option_meanings("WDT", is_move=True) == {}
    told = option_meanings(" wdt = 400,InvokeTimeout=1,odd", is_move=False)
    assert list(told) == ["WDT", "InvokeTimeout"]
    assert list(option_meanings("NEXT,Speed=50", is_move=True)) == ["SPEED", "NEXT"]


def test_what_answers_stand_for() -> None:
    assert result_meanings(87, "getStatus", 3) == ("running",)
    assert result_meanings(17, "GetAutoMode", 2) == ("external automatic",)
    assert result_meanings(17, "SysState", 1 << 2 | 1 << 5) == (
        "servo on",
        "automatic mode, token not at the pendant",
    )
    assert result_meanings(87, "GetStatus", 9) == result_meanings(64, "GetStatus", 3) == ()


def test_numbers_of_the_samples() -> None:
    # Robot_Move 1 is PTP, Task_Start 1 one cycle, GetStatus 3 a running task (DENSO's Python samples).
    assert enumerations.INTERPOLATIONS[1].startswith("P")
    assert enumerations.TASK_START_MODES[1] == "one cycle"
    assert enumerations.TASK_STATES[3] == "running"
    assert enumerations.AUTO_MODES[2].startswith("external")
