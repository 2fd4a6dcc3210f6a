"""Hostile numbers in documents, expressions and messages: refused in one sentence, or bounded."""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path

import msgspec
import pytest

from bcapscope.errors import LocalProtocolError
from bcapscope.faults.document import DocumentError, RuleFile, read_document
from bcapscope.faults.fault_kinds import ACTIONS
from bcapscope.faults.fault_notation import read_fault
from bcapscope.player.arm_limits import MAX_LIMIT, UNKNOWN_ARM, with_limits
from bcapscope.player.trajectory import TrajectoryError
from bcapscope.player.trajectory_reader import read_trajectories
from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT
from bcapscope.protocol.codec.variant_notation import parse_variant
from bcapscope.proxy.control_api import ControlApi
from bcapscope.simulator.scenario import Scenario
from bcapscope.traffic.filter.compiler import FilterError, compile_filter
from bcapscope.traffic.filter.field_table import RecordKind
from tests.cli.test_numbers import HOSTILE
from tests.proxy.test_rule_policy import rules

NUMBERS = {
    **HOSTILE,
    "infinity in YAML": ".inf",
    "no number in YAML": ".nan",
    "an integer in base 60": ":".join(["59"] * 200),
    "a binary integer": "0b" + "1" * 20_000,
    "a large percentage": "9" * 40 + "%",
    "a long duration": "9" * 400 + "s",
    "an endless span": "1e400..1e999",
    "zeros in front": "010",
}


def check_refusal(error: Exception) -> None:
    """Check that a person can read why."""
    text = str(error)
    check_size(error, 600)
    assert "set_int_max_str_digits" not in text
    assert "invalid literal for" not in text


def check_size(error: Exception, most: int) -> None:
    """Check that what an error says is not beyond measure, and is not from Python itself."""
    assert len(str(error)) < most
    assert "set_int_max_str_digits" not in str(error)


def check_finite(value: object) -> None:
    """Check every number inside a struct."""
    if isinstance(value, msgspec.Struct):
        for name in value.__struct_fields__:
            check_finite(getattr(value, name))
    elif isinstance(value, dict):
        check_finite(tuple(value.values()))
    elif isinstance(value, tuple | list):
        for each in value:
            check_finite(each)
    elif isinstance(value, int | float):
        assert math.isfinite(value)


@pytest.mark.parametrize("text", NUMBERS.values(), ids=NUMBERS)
@pytest.mark.parametrize("action", ACTIONS)
def test_rule_files(action: str, text: str) -> None:
    for field, shape in product(ACTIONS[action].__struct_encode_fields__, ("{}", "{{arg[2]: {}}}", "[{}]")):
        document = f"faults:\n  - {{action: {action}, {field}: {shape.format(text)}}}\n"
        try:
            found = read_document(document, RuleFile)
        except DocumentError as error:
            check_refusal(error)
        else:
            check_finite([each for each in found.faults if field != "set"])


@pytest.mark.parametrize("text", NUMBERS.values(), ids=NUMBERS)
@pytest.mark.parametrize("action", ACTIONS)
def test_faults_in_one_line(action: str, text: str) -> None:
    main = "" if action == "burst" else "1ms"
    for line in (
        f"{action}={text}",
        f"{action}={main}/{text}",
        f"{action} {text}%",
        *(f"{action} {field} {text}" for field in ACTIONS[action].__struct_encode_fields__),
        *(f"{action} {word} arg[2]={text}" for word in ("set", "limit", "step")),
        f"{action} set arg[{text}]=1",
        f"{action} if serial == {text}",
    ):
        try:
            read_fault(line)
        except ValueError as error:
            check_refusal(error)


@pytest.mark.parametrize("text", NUMBERS.values(), ids=NUMBERS)
def test_scenarios(text: str) -> None:
    places = (
        *(f"start: {{{name}: {text}}}" for name in _fields("start")),
        *(f"client: {{{name}: {text}}}" for name in _fields("client")),
        *(f"limits: {{J1: {{{name}: {text}}}}}" for name in ("low", "high", "speed", "acceleration")),
        *(f"variables: {{{name}: {text}}}" for name in ("I1", "F1", "D1", "S1", "IO1", "IOW8", "I9999999")),
        f"variables: {{P1: [{text}]}}",
        *(f"{name}: {text}" for name in Scenario.__struct_encode_fields__ if name != "title"),
    )
    for place in places:
        try:
            found = read_document(f"title: x\n{place}\n", Scenario)
        except DocumentError as error:
            check_refusal(error)
        else:
            check_finite(found)


def _fields(name: str) -> list[str]:
    kinds = {each.name: each.type for each in msgspec.structs.fields(Scenario)}
    return [each.encode_name for each in msgspec.structs.fields(kinds[name])]


@pytest.mark.parametrize("text", NUMBERS.values(), ids=NUMBERS)
@pytest.mark.parametrize("kind", RecordKind)
def test_filters(kind: RecordKind, text: str) -> None:
    for expression in (
        "serial == {}",
        "time > {}",
        "started < {}",
        "latency > {}ms",
        "latency_ms > {}",
        "hresult == {}",
        "arg[{}] == 1",
        "arg[0] in (1, {})",
        "src == 10.0.0.1:{}",
        "length < -{}",
    ):
        try:
            compile_filter(expression.format(text), kind)
        except FilterError as error:
            check_size(error, 200 + 2 * len(text))


@pytest.mark.parametrize("text", NUMBERS.values(), ids=NUMBERS)
@pytest.mark.parametrize("vt", [each for each in VT if each not in (VT.VARIANT, VT.EMPTY, VT.NULL)])
def test_arguments_of_calls(vt: VT, text: str) -> None:
    for form in (f"{vt.name}:{text}", f"{vt.name}[]:1,{text}", text):
        try:
            value = parse_variant(form)
        except ValueError as error:
            check_refusal(error)
            continue
        try:
            encode_frame(1, 0, 1, [value])
        except LocalProtocolError as error:
            pytest.fail(f"{form[:50]!r} was read, and cannot be sent: {error}")


@pytest.mark.parametrize("text", NUMBERS.values(), ids=NUMBERS)
def test_questions_to_a_proxy(text: str) -> None:
    api = ControlApi(rules())
    quoted = msgspec.json.encode(text).decode()
    for value, form in product(
        (text, quoted, f"[{text}]"),
        (
            '{{"do":"forward","number":{}}}',
            '{{"do":"edit","number":1,"hex":{}}}',
            '{{"do":"intercept","patience":{}}}',
            '{{"do":"add","rule":{}}}',
            '{{"do":"add","fault":{{"action":"drop","probability":{}}}}}',
            '{{"do":"add","fault":{{"action":"rewrite","step":{{"arg[2]":{}}}}}}}',
        ),
    ):
        reply, _ = api.handle_line(form.format(value).encode(), 0)
        answer = msgspec.json.decode(reply)
        assert answer["ok"] in (True, False)
        assert "set_int_max_str_digits" not in reply.decode()
        assert len(reply) < 8000 + 3 * len(text)


@pytest.mark.parametrize("text", NUMBERS.values(), ids=NUMBERS)
def test_trajectories(text: str, tmp_path: Path) -> None:
    joints = "joint_names: [J1, J2, J3, J4, J5, J6]"
    point = "{{positions: [0, 0, 0, 0, 0, {}], time_from_start: {{sec: {}, nanosec: 0}}}}"
    points = ", ".join(point.format(text, index) for index in range(3))
    times = ", ".join(point.format(0, text) for index in range(3))
    for name, content in (
        ("way.csv", f"time,J1,J2,J3,J4,J5,J6\n0,0,0,0,0,0,{text}\n0.1,0,0,0,0,0,1\n"),
        ("way.csv", f"time,J1,J2,J3,J4,J5,J6\n0,0,0,0,0,0,1\n{text},0,0,0,0,0,1\n"),
        ("way.yaml", f"{joints}\npoints: [{points}]\n"),
        ("way.yaml", f"{joints}\npoints: [{times}]\n"),
        ("way.json", f'{{"joint_names": ["J1"], "points": [{{"positions": [{text}]}}]}}'),
    ):
        path = tmp_path / name
        path.write_text(content)
        try:
            read_trajectories(path)
        except TrajectoryError as error:
            check_refusal(error)


@pytest.mark.parametrize("text", NUMBERS.values(), ids=NUMBERS)
def test_limits_of_an_arm(text: str) -> None:
    for form in (f"J1={text}..{text}", f"J1=0..{text}", f"J1.speed={text}", f"J{text}=0..1"):
        try:
            found = with_limits(UNKNOWN_ARM, [form])
        except ValueError as error:
            check_size(error, 200 + 3 * len(text))
        else:
            assert all(
                abs(end) <= MAX_LIMIT
                for end in (found.axes["J1"].low, found.axes["J1"].high)
                if "speed" not in form
            )
