"""The tables in ``docs`` of what needs arming and what passes a read-only proxy say what the code does."""

from __future__ import annotations

import re
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

import pytest

from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.guard import always_passes, needs_arming, passes_read_only, request_effect
from bcapscope.protocol.tables.call_effect import CallEffect
from bcapscope.protocol.tables.command_catalogue import commands_of
from bcapscope.protocol.tables.function_table import FUNCTIONS, ID

DOCS = Path(__file__).parent.parent / "docs"
SENTENCE = "**No stop in software is a safety function"
EXECUTES = (17, 28, 64, 87)
HANDLE = Variant(VT.I4, 1)
VARIABLES = {
    "@SERVO_ON TRUE": Variant(VT.BOOL, True),
    "@SERVO_ON FALSE": Variant(VT.BOOL, False),
    "@STOP 1": Variant(VT.I4, 1),
}
SWITCHED_OFF = {"Motor 0", "GiveArm", "@SERVO_ON FALSE", "@STOP 1"}


class Call(NamedTuple):
    """A call that a table names.

    Attributes:
        name: as the table has it.
        function_id: of the request.
        arguments: of the request.
        variable: name of the variable that it writes.
    """

    name: str
    function_id: int
    arguments: tuple[Variant, ...]
    variable: str = ""

    @property
    def row(self) -> str:
        """The label of the row that it belongs to."""
        if always_passes(self.function_id, self.arguments):
            return "Stop or release"
        if self.name in SWITCHED_OFF:
            return "Switch off"
        return {
            CallEffect.READS: "Read or open",
            CallEffect.SESSION: "Read or open",
            CallEffect.CHANGES: "Change a value or a setting",
            CallEffect.ENERGISES: "Energise, permit motion, or make running programs faster",
            CallEffect.MOVES: "Move",
        }[request_effect(self.function_id, self.arguments, self.variable)]

    @property
    def verdicts(self) -> tuple[str, str]:
        """The last two cells of its row."""
        armed = needs_arming(self.function_id, self.arguments, self.variable)
        passes = passes_read_only(self.function_id, self.arguments)
        return ("needed" if armed else "not needed"), ("passes" if passes else "refused")


def calls() -> Iterator[Call]:
    """Yield every function, every command of the catalogue, and the switches with either value."""
    text = Variant(VT.BSTR, "")
    for function in FUNCTIONS.values():
        if function.id not in EXECUTES:
            yield Call(function.name, function.id, (HANDLE, text, text))
        for command in commands_of(function.id):
            arguments = (HANDLE, Variant(VT.BSTR, command.name), Variant(VT.I4, 1))
            yield Call(command.name, function.id, arguments)
    for name in ("Motor 0", "slvChangeMode 0"):
        arguments = (HANDLE, Variant(VT.BSTR, name.partition(" ")[0]), Variant(VT.I4, 0))
        yield Call(name, ID["Robot_Execute"], arguments)
    for name, value in VARIABLES.items():
        yield Call(name, ID["Variable_PutValue"], (HANDLE, value), name.partition(" ")[0])


def rows(page: str) -> dict[str, tuple[set[str], list[str]]]:
    """Read the rows that begin with a label in bold: the calls that each names, and its other cells."""
    text = (DOCS / page).read_text(encoding="utf-8")
    found = {}
    for line in re.findall(r"(?m)^\| \*\*.*\|$", text):
        first, *others = (cell.strip() for cell in line.strip("|").split(" | "))
        label = re.findall(r"\*\*(.*?)\*\*", first)[0]
        names = first.partition(": ")[2]
        found[label] = (set(re.findall(r"`([^`]+)`", names)), others)
    return found


def named(call: Call, names: set[str]) -> bool:
    return any(fnmatchcase(call.name, name) for name in names)


def test_every_call_is_in_its_row_and_in_no_other() -> None:
    table = rows("controllers.md")
    for call in calls():
        for label, (names, verdicts) in table.items():
            if label == call.row:
                assert names == set() or named(call, names), f"docs/controllers.md: {call.name} is missing"
                assert tuple(verdicts) == call.verdicts, call
            else:
                assert not named(call, names), f"docs/controllers.md: {call.name} is not in row {call.row!r}"


def test_every_name_is_a_call() -> None:
    every = [call.name for call in calls()]
    for names, _ in (*rows("controllers.md").values(), *rows("proxy.md").values()):
        for name in names - {"Service_Start", "Controller_Connect"}:
            assert any(fnmatchcase(each, name) for each in every), name


def test_the_proxy_page_agrees() -> None:
    all_calls, proxy = rows("controllers.md"), rows("proxy.md")
    for label in ("Stop or release", "Switch off"):
        assert proxy[label][0] == all_calls[label][0]
        assert proxy[label][1][0].startswith(all_calls[label][1][1])


@pytest.mark.parametrize("page", ["controllers.md", "proxy.md"])
def test_the_table_stands_next_to_the_warning(page: str) -> None:
    lines = (DOCS / page).read_text(encoding="utf-8").splitlines()
    (warning,) = (number for number, line in enumerate(lines) if SENTENCE in line)
    table = next(number for number, line in enumerate(lines) if line.startswith("| **Stop or release**"))
    assert abs(warning - table) < 10
