"""The function table against facts from elsewhere: prototypes, DENSO's slides of 2009, recorded vectors."""

from __future__ import annotations

import dataclasses
import json
from collections import Counter
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.tables.function_table import (
    FUNCTIONS,
    ObjectClass,
    ResultKind,
    function_by_name,
    function_name,
    signed_function_id,
)
from tests.shared_folder import SHARED

VECTORS = SHARED / "vectors.json"

# First and last function of each class, and how many there are (orin_bcap C/include/bcap_funcid.h).
CLASS_RANGES = [
    (ObjectClass.SERVICE, 1, 2),
    (ObjectClass.CONTROLLER, 3, 25),
    (ObjectClass.EXTENSION, 26, 36),
    (ObjectClass.FILE, 37, 61),
    (ObjectClass.ROBOT, 62, 84),
    (ObjectClass.TASK, 85, 99),
    (ObjectClass.VARIABLE, 100, 111),
    (ObjectClass.COMMAND, 112, 127),
    (ObjectClass.MESSAGE, 128, 137),
]


def test_only_a_first_argument_may_be_a_handle() -> None:
    without = {function.name for function in FUNCTIONS.values() if not function.takes_handle}
    assert without == {"Service_Start", "Service_Stop", "Controller_Connect"}


def test_there_are_137_functions_with_distinct_names() -> None:
    assert list(FUNCTIONS) == list(range(1, 138))
    assert len({function.name for function in FUNCTIONS.values()}) == 137


@pytest.mark.parametrize(("owner", "first", "last"), CLASS_RANGES)
def test_ids_of_a_class_are_one_range(owner: ObjectClass, first: int, last: int) -> None:
    assert [f.id for f in FUNCTIONS.values() if f.owner is owner] == list(range(first, last + 1))


@pytest.mark.parametrize(
    ("function_id", "name", "params", "result"),
    [
        # The reference page for Robot_Execute in DENSO Wave 2009, How to use the Slave mode.
        (
            64,
            "Robot_Execute",
            [("hRobot", "VT_I4"), ("bstrCommand", "VT_BSTR"), ("vntParam", "VARIANT")],
            ResultKind.VARIANT,
        ),
        (2, "Service_Stop", [], ResultKind.NONE),
        (
            3,
            "Controller_Connect",
            [
                ("bstrName", "VT_BSTR"),
                ("bstrProvider", "VT_BSTR"),
                ("bstrMachine", "VT_BSTR"),
                ("bstrOption", "VT_BSTR"),
            ],
            ResultKind.HANDLE,
        ),
        (
            65,
            "Robot_Accelerate",
            [("hRobot", "VT_I4"), ("lAxis", "VT_I4"), ("fAccel", "VT_R4"), ("fDecel", "VT_R4")],
            ResultKind.NONE,
        ),
        (
            73,
            "Robot_Rotate",
            [
                ("hRobot", "VT_I4"),
                ("vntRotSuf", "VARIANT"),
                ("fDeg", "VT_R4"),
                ("vntPivot", "VARIANT"),
                ("bstrOption", "VT_BSTR"),
            ],
            ResultKind.NONE,
        ),
        (115, "Command_PutTimeout", [("hCommand", "VT_I4"), ("newVal", "VT_I4")], ResultKind.NONE),
        (118, "Command_PutParameters", [("hCommand", "VT_I4"), ("newVal", "VARIANT")], ResultKind.NONE),
        (130, "Message_GetDateTime", [("hMessage", "VT_I4")], ResultKind.DATE),
        (86, "Task_GetVariableNames", [("hTask", "VT_I4"), ("bstrOption", "VT_BSTR")], ResultKind.NAMES),
    ],
)
def test_signatures(function_id: int, name: str, params: list[tuple[str, str]], result: ResultKind) -> None:
    function = FUNCTIONS[function_id]
    assert function.name == name
    assert [tuple(param) for param in function.params] == params
    assert function.result is result


def test_every_class_but_service_takes_its_handle_first() -> None:
    for function in FUNCTIONS.values():
        if function.owner is ObjectClass.SERVICE or function.name == "Controller_Connect":
            assert not any(param.name.startswith("h") for param in function.params)
        else:
            assert function.params[0] == (f"h{function.owner}", "VT_I4")
            assert not any(param.name.startswith("h") for param in function.params[1:])


def test_handle_life() -> None:
    creating = {f.id for f in FUNCTIONS.values() if f.creates}
    releasing = {f.id for f in FUNCTIONS.values() if f.releases}
    assert creating == {1, 3, 5, 6, 7, 8, 9, 10, 18, 26, 37, 38, 62, 85}
    assert releasing == {2, 4, 36, 61, 84, 99, 111, 127, 137}
    assert {f.id for f in FUNCTIONS.values() if f.result is ResultKind.HANDLE} == creating - {1}
    for function in FUNCTIONS.values():
        assert function.releases in (None, function.owner)
        if function.result is ResultKind.HANDLE:
            assert function.result_name == f"h{function.creates}"
            if function.id != 3:
                assert function.name in (f"{function.owner}_Get{function.creates}",)


def test_every_class_that_is_created_can_be_released() -> None:
    created = {f.creates for f in FUNCTIONS.values() if f.creates}
    assert created == {f.releases for f in FUNCTIONS.values() if f.releases} == set(ObjectClass)


def test_result_kinds_count() -> None:
    # Counted from the prototypes of the C client.
    counts = Counter(f.result for f in FUNCTIONS.values())
    assert counts[ResultKind.HANDLE] == 13
    assert counts[ResultKind.DATE] == 5
    assert counts[ResultKind.NAMES] == 11
    assert sum(counts.values()) == 137


def test_the_two_slips_of_the_c_server_are_noted() -> None:
    assert {f.id for f in FUNCTIONS.values() if f.note} == {112, 124}


@pytest.mark.parametrize("name", ["Robot_Execute", "robot_execute", "ROBOT_EXECUTE"])
def test_lookup_by_name_ignores_case(name: str) -> None:
    function = function_by_name(name)
    assert function is not None
    assert function.id == 64


def test_unknown_name() -> None:
    assert function_by_name("Robot_Fly") is None


@given(st.integers(-(2**33), 2**33))
def test_any_number_has_a_name(number: int) -> None:
    name = function_name(number)
    assert (1 <= number <= 137) == (name != f"Unknown({signed_function_id(number)})")


def test_the_table_is_frozen() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        FUNCTIONS[1].id = 2  # type: ignore[misc]
    with pytest.raises(TypeError):
        FUNCTIONS[138] = FUNCTIONS[1]  # type: ignore[index]


@pytest.mark.interop
def test_requests_of_densos_python_client_have_these_arguments() -> None:
    if not VECTORS.exists():
        pytest.skip(f"{VECTORS} is not here")
    types = {"VT_I4": 3, "VT_R4": 4, "VT_BSTR": 8}
    vectors: list[dict[str, Any]] = json.loads(VECTORS.read_text())
    seen = set()
    for vector in vectors:
        head, _, name = vector["name"].partition("_")[2].partition("_")
        if vector["name"].startswith("req_") and head.isdigit() and int(head) == vector["function_id"]:
            function = FUNCTIONS[vector["function_id"]]
            assert function.name == name
            assert len(vector["args"]) == len(function.params)
            for arg, param in zip(vector["args"], function.params, strict=True):
                assert arg["type"] == types.get(param.type, arg["type"])
            seen.add(function.id)
    assert len(seen) > 20


@pytest.mark.parametrize(
    ("code", "function_id"),
    [
        (0x7FFFFFFF, 0x7FFFFFFF),
        (0x80000000, -0x80000000),
        (0xFFFFFFFF, -1),
        (0x100000000, 0x100000000),
        (64, 64),
        (-1, -1),
    ],
)
def test_the_number_of_a_function_is_signed(code: int, function_id: int) -> None:
    assert signed_function_id(code) == function_id
