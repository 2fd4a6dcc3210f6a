"""The names of `bcapscope`: programs of users rely on them."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name

import pytest

import bcapscope

ROOT = Path(__file__).parent.parent.parent
HEAVY = {"asyncio", "numpy", "orjson", "pandas", "pyarrow", "scapy", "textual"}

PUBLIC_NAMES = [
    "AnnotatedFrame",
    "Argument",
    "BcapError",
    "Call",
    "CallTimeout",
    "Capture",
    "CaptureError",
    "ControllerError",
    "FileWriteError",
    "FilterError",
    "Finding",
    "Frame",
    "InputError",
    "LocalProtocolError",
    "MissingExtraError",
    "Problem",
    "Proxy",
    "Records",
    "RemoteProtocolError",
    "ReportedFinding",
    "Simulator",
    "SlaveSession",
    "TableRecords",
    "TooLargeError",
    "VT",
    "Variant",
    "connect",
    "decode",
    "encode",
    "open",
]
"""The public surface. A name that goes needs a version in which it is deprecated: see CHANGELOG.md."""


def test_the_public_names_are_pinned() -> None:
    assert sorted(bcapscope.__all__) == PUBLIC_NAMES


def test_the_scapy_layer_is_pinned() -> None:
    module = import_module("bcapscope.scapy_layer")
    assert module.__all__ == ["BCAP"]
    names = "soh length serial reserved function hresult argc args trailer eot"
    assert [field.name for field in module.BCAP.fields_desc] == names.split()
    properties = {name for name, value in vars(module.BCAP).items() if isinstance(value, property)}
    assert properties == {"is_response", "function_id", "command_name", "retry_of", "frame"}


def test_type_checkers_see_the_same_names() -> None:
    tree = ast.parse(Path(str(bcapscope.__file__)).read_text("utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    imported = {
        alias.asname or "" for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assigned = {ast.unparse(node.targets[0]) for node in block.body if isinstance(node, ast.Assign)}
    assert (imported | assigned) - {""} == set(PUBLIC_NAMES)


@pytest.mark.parametrize("name", PUBLIC_NAMES)
def test_each_name_is_there_listed_and_documented(name: str) -> None:
    assert name in dir(bcapscope)
    assert getattr(bcapscope, name).__doc__


def test_the_reference_describes_each_name_and_nothing_that_does_not_exist() -> None:
    page = (ROOT / "docs" / "reference.md").read_text("utf-8")
    described = re.findall(r"(?m)^::: (\S+)$", page)
    assert {f"bcapscope.{name}" for name in PUBLIC_NAMES} <= set(described)
    for path in described:
        assert resolve_name(path).__doc__, path


def test_another_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'bcapscope' has no attribute 'Packet'"):
        _ = bcapscope.Packet  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "program",
    [
        "import bcapscope",
        "import bcapscope.api.single_frame",
        "import bcapscope.api.opened_capture",
        "import bcapscope; print(*bcapscope.open('captures/slave-session.pcapng', filter='t > 0').calls)",
        "import bcapscope; bcapscope.decode(bcapscope.encode('Robot_Execute', [2, 'CurJnt', None]))",
    ],
)
def test_nothing_heavy_is_imported(program: str) -> None:
    program += "; import sys; print(*sys.modules)"
    argv = [sys.executable, "-c", program]
    done = subprocess.run(argv, cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "bcapscope" in loaded
    assert not loaded & HEAVY
