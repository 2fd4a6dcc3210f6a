"""What can be imported from `bcapscope.protocol` itself."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from bcapscope import protocol
from bcapscope.protocol.codec import variant


@pytest.mark.parametrize("name", protocol.__all__)
def test_each_name_is_there_and_listed(name: str) -> None:
    assert getattr(protocol, name) is not None
    assert name in dir(protocol)


def test_a_name_is_the_one_of_its_module() -> None:
    assert protocol.Variant is variant.Variant


def test_another_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'Packet'"):
        _ = protocol.Packet  # type: ignore[attr-defined]


def test_a_submodule_loads_none_of_the_others() -> None:
    program = "import bcapscope.protocol.text_format, sys\nprint(*(n for n in sys.modules if 'col.' in n))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "bcapscope.protocol.text_format\n"


def test_programs_copied_earlier_still_run_and_are_warned() -> None:
    old = importlib.import_module("bcapscope.protocol.variant")
    with pytest.warns(DeprecationWarning, match=r"import VT and Variant from bcapscope\.protocol$") as warned:
        assert old.Variant is variant.Variant
    assert [each.filename for each in warned] == [__file__]


def test_no_submodule_imports_from_the_front_door() -> None:
    found = []
    for path in Path(protocol.__path__[0]).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module == "bcapscope.protocol":
                names = {alias.name for alias in node.names}
                found += [f"{path.name}: {name}" for name in names.intersection(protocol.__all__)]
    assert found == []
