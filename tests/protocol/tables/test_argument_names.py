"""What the arguments of a frame are called."""

from __future__ import annotations

import pytest

from bcapscope.protocol.tables.function_table import Param, request_param, result_param


@pytest.mark.parametrize(
    ("function_id", "index", "role"),
    [
        (64, 0, Param("hRobot", "VT_I4")),
        (64, 2, Param("vntParam", "VARIANT")),
        (64, 3, Param("arg4", "VARIANT")),
        (200, 0, Param("arg1", "VARIANT")),
        (None, 1, Param("arg2", "VARIANT")),
    ],
)
def test_arguments_of_requests(function_id: int | None, index: int, role: Param) -> None:
    assert request_param(function_id, index) == role


@pytest.mark.parametrize(
    ("function_id", "index", "role"),
    [
        (7, 0, Param("hRobot", "VT_I4")),
        (49, 0, Param("pVal", "VT_BSTR")),
        (64, 0, Param("pVal", "VARIANT")),
        (2, 0, Param("pVal", "VARIANT")),
        (None, 0, Param("pVal", "VARIANT")),
        (7, 1, Param("arg2", "VARIANT")),
    ],
)
def test_arguments_of_replies(function_id: int | None, index: int, role: Param) -> None:
    assert result_param(function_id, index) == role
