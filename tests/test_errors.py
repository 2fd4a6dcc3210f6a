"""What exceptions say, since that is what users read."""

from __future__ import annotations

from bcapscope.errors import Attempt, AttemptEvent, BcapError, CallTimeout, ControllerError
from bcapscope.protocol.tables.hresult import describe_hresult


def test_a_time_out_lists_every_try() -> None:
    start = 5_000_000_000
    attempts = (
        Attempt(7, 0, start, (AttemptEvent(start + 19_000_000, "S_OK"),)),
        Attempt(8, 7, start + 16_000_000),
    )
    error = CallTimeout("Robot_Execute slvMove", attempts)
    assert str(error).splitlines() == [
        "Robot_Execute slvMove got no reply in time, 2 attempts:",
        "  serial 7, reserved 0, sent at 0.000 ms: S_OK at 19.000 ms",
        "  serial 8, reserved 7, sent at 16.000 ms: no reply",
    ]
    assert error.attempts == attempts
    assert isinstance(error, TimeoutError)
    assert isinstance(error, BcapError)


def test_what_came_again_and_again_is_told_once() -> None:
    came = [AttemptEvent(each * 100_000_000, "S_EXECUTING") for each in range(1, 21)]
    attempt = Attempt(7, 0, 0, (*came, AttemptEvent(2_004_000_000, "S_OK")))
    head, told = str(attempt.describe(0)).split(": ")
    assert head == "serial 7, reserved 0, sent at 0.000 ms"
    assert told == "S_EXECUTING × 20 at 100.000 … 2000.000 ms, S_OK at 2004.000 ms"


def test_a_refusal_tells_what_and_why() -> None:
    error = ControllerError(
        "Robot_Execute slvMove", 0x83500121, "0x83500121", describe_hresult(0x83500121).meaning
    )
    assert str(error) == f"Robot_Execute slvMove was refused: 0x83500121, {describe_hresult(0x83500121).text}"
    assert error.hresult == 0x83500121
