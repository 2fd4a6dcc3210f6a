"""Numbers and strings with a meaning."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol import enumerations
from bcapscope.protocol.enumerations import options, pass_motion, provider, stands_for, sys_state


def test_sys_state_names_the_bits() -> None:
    assert sys_state(0) == ()
    assert sys_state(1 << 2 | 1 << 10) == ("servo on", "emergency stop")
    assert sys_state(1 << 9) == ("bit 9",)


@given(st.integers(-(2**31), 2**31 - 1))
def test_sys_state_names_each_bit_of_any_number_once(value: int) -> None:
    assert len(sys_state(value)) == (value & 0xFFFFFFFF).bit_count() == len(set(sys_state(value)))


def test_providers_in_any_case() -> None:
    assert provider("caoprov.denso.vrc") == provider("CaoProv.DENSO.VRC")
    assert "RC9" in (provider("CaoProv.DENSO.VRC9") or "")
    assert provider("CaoProv.Nobody") is None


def test_pass_motions() -> None:
    assert [pass_motion(value) for value in (-2, -1, 0, 10)] == ["@E", "@P", "@0", "@10"]


def test_keys_of_options() -> None:
    assert options("", motion=False) == options("WDT", motion=True) == {}
    told = options(" wdt = 400,InvokeTimeout=1,odd", motion=False)
    assert list(told) == ["WDT", "InvokeTimeout"]
    assert list(options("NEXT,Speed=50", motion=True)) == ["SPEED", "NEXT"]


def test_what_answers_stand_for() -> None:
    assert stands_for(87, "getStatus", 3) == ("running",)
    assert stands_for(17, "GetAutoMode", 2) == ("external automatic",)
    assert stands_for(17, "SysState", 1 << 2 | 1 << 5) == (
        "servo on",
        "automatic mode, token not at the pendant",
    )
    assert stands_for(87, "GetStatus", 9) == stands_for(64, "GetStatus", 3) == ()


def test_numbers_of_the_samples() -> None:
    # Robot_Move 1 is PTP, Task_Start 1 one cycle, GetStatus 3 a running task (DENSO's Python samples).
    assert enumerations.INTERPOLATIONS[1].startswith("P")
    assert enumerations.TASK_START_MODES[1] == "one cycle"
    assert enumerations.TASK_STATES[3] == "running"
    assert enumerations.AUTO_MODES[2].startswith("external")
