"""Print the lowest version that pyproject.toml allows of each direct dependency, as constraints for pip."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path

from packaging.requirements import Requirement

EXTRAS = ("arrow", "pandas", "report", "serve", "suite")
"""What the tests run with; the tools of the extra `test` only look at the source."""


def lowest(requirements: Iterable[str]) -> Iterator[str]:
    """Give out ``name==version`` for each requirement that has a lower bound."""
    for requirement in map(Requirement, requirements):
        for bound in requirement.specifier:
            if bound.operator == ">=":
                yield f"{requirement.name}=={bound.version}"


def main() -> None:
    """Print the constraints, one per line."""
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text("utf-8"))["project"]
    extras = (project["optional-dependencies"][name] for name in EXTRAS)
    for line in lowest(chain(project["dependencies"], *extras)):
        print(line)


if __name__ == "__main__":
    main()
