"""YAML texts and titles of the bundled scenarios."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources

_TITLE = "title: "


def bundled_scenarios() -> Mapping[str, str]:
    """Return the YAML of the bundled scenarios by name, in alphabetical order."""
    files = resources.files("bcapscope.simulator").joinpath("scenarios").iterdir()
    found = {each.name.removesuffix(".yaml"): each for each in files if each.name.endswith(".yaml")}
    return {name: found[name].read_text(encoding="utf-8") for name in sorted(found)}


def bundled_titles() -> Mapping[str, str]:
    """The title is in the first line of each file, so that no slow YAML parser is needed."""
    first_lines = {name: text.partition("\n")[0] for name, text in bundled_scenarios().items()}
    return {name: line.removeprefix(_TITLE) for name, line in first_lines.items()}
