"""The Python blocks of the documentation about tests of clients run as they are shown, and have sound types.

A block with tests runs in pytest, beside a client of its own.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import bcapscope
from bcapscope.protocol.tables.function_table import FUNCTIONS
from tests.user_types import reported_by_mypy

_CLIENT = """
import asyncio
import bcapscope.client as client

def run_my_client(host: str, port: int) -> None:
    async def run() -> None:
        async with client.connect(client.over_udp(host, port)) as service:
            await service.connect("", "CaoProv.DENSO.VRC", "localhost")
    asyncio.run(run())

"""
_ROOT = Path(__file__).parents[2]


def _python_blocks(page: str) -> list[str]:
    return re.findall(r"(?ms)^```python\n(.*?)^```$", (_ROOT / "docs" / page).read_text(encoding="utf-8"))


_BLOCKS = [
    pytest.param(block, id=f"{page}-{number}")
    for page in ("simulator.md", "testing.md")
    for number, block in enumerate(_python_blocks(page))
]


@pytest.mark.parametrize("block", _BLOCKS)
def test_a_python_block_runs(block: str, tmp_path: Path) -> None:
    program = tmp_path / "test_block.py"
    program.write_text(_CLIENT + block, encoding="utf-8")
    options = ["-m", "pytest", "-q", "--strict-markers"] if "def test_" in block else []
    subprocess.run([sys.executable, "-W", "error", *options, str(program)], cwd=tmp_path, check=True)


@pytest.mark.parametrize("page", ["simulator.md", "testing.md", "controllers.md"])
def test_python_blocks_have_sound_types(page: str, tmp_path: Path) -> None:
    paths = [tmp_path / f"block_{number}.py" for number in range(len(_python_blocks(page)))]
    for path, block in zip(paths, _python_blocks(page), strict=True):
        path.write_text(_CLIENT + block, encoding="utf-8")
    assert reported_by_mypy(*paths) == []


@pytest.mark.parametrize("number", range(3))
def test_the_library_connects_as_the_page_on_controllers_shows(number: int, tmp_path: Path) -> None:
    block = _python_blocks("controllers.md")[number]
    if "async def print_position" in block:
        block += "\nimport asyncio\nasyncio.run(print_position())\n"
    with bcapscope.Simulator() as simulator:
        block = block.replace('"192.168.0.1"', f'"{simulator.host}", {simulator.port}')
        subprocess.run([sys.executable, "-W", "error", "-c", block], cwd=tmp_path, check=True)
        assert {FUNCTIONS[call.kind.function_id].name for call in simulator.calls} > {
            "Controller_GetRobot",
            "Robot_Execute",
            "Service_Stop",
        }
