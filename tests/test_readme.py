"""What the README and the pages in ``docs`` show is what is printed, and their links lead somewhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = {
    path: path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
}


def shown() -> list[tuple[tuple[str, str], ...]]:
    """List each block of command lines that a page shows, once. A command line has its output beside it."""
    blocks = [block for page in PAGES.values() for block in re.findall(r"(?ms)^```console\n(.*?)^```$", page)]
    runs = [re.split(r"^\$ ", block, flags=re.MULTILINE)[1:] for block in blocks]
    return list(dict.fromkeys(tuple((each.partition("\n")[::2]) for each in block) for block in runs))


def anchors(page: str) -> set[str]:
    """Name the headings of a page as links name them."""
    titles = re.findall(r"(?m)^#+ (.+)$", re.sub(r"(?ms)^```.*?^```$", "", page))
    return {re.sub(r"[^\w -]", "", title).lower().replace(" ", "-") for title in titles}


@pytest.mark.parametrize("block", shown(), ids=lambda block: block[0][0][:60])
def test_every_sample_is_what_is_printed(block: tuple[tuple[str, str], ...], tmp_path: Path) -> None:
    """The commands of one block may depend on each other, so they run in order."""
    program = tmp_path / "bcapscope"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m bcapscope "$@"\n')
    program.chmod(0o755)
    env = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    for command, expected in block:
        done = subprocess.run(["sh", "-c", command], cwd=ROOT, env=env, capture_output=True, check=False)
        assert done.stdout.decode() == expected


def test_there_are_samples() -> None:
    assert len(shown()) >= 7


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_every_link_leads_somewhere(path: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", PAGES[path]):
        name, _, anchor = link.partition("#")
        there = (path.parent / name).resolve() if name else path
        assert there.exists(), link
        assert not anchor or anchor in anchors(PAGES[there]), link


def test_the_readme_leads_to_every_page() -> None:
    assert {f"docs/{path.name}" for path in PAGES if path.parent.name == "docs"} <= set(
        re.findall(r"\]\(([^)\s#]+)", PAGES[ROOT / "README.md"])
    )


def named_modules() -> set[str]:
    """Return the modules and folders that the architecture page names, such as ``traffic/pipeline``."""
    names = re.findall(r"`([\w./]+)`", PAGES[ROOT / "docs" / "architecture.md"])
    rooms = {path.name for path in (ROOT / "bcapscope").iterdir() if path.is_dir()}
    return {name for name in names if name.partition("/")[0] in rooms and "/" in name}


@pytest.mark.parametrize("name", sorted(named_modules()))
def test_every_module_of_the_architecture_page_exists(name: str) -> None:
    *folders, last = name.split("/")
    folder = ROOT.joinpath("bcapscope", *folders)
    module, _, attribute = last.partition(".")
    path = folder / f"{module}.py"
    assert (folder / last).exists() or path.exists(), name
    if attribute and not (folder / last).exists():
        assert re.search(rf"\b{attribute.partition('.')[0]}\b", path.read_text(encoding="utf-8")), name
