"""YAML as events, one after the other: the one way in which YAML is read here.

PyYAML's composers call themselves for each level. The one in C, which `msgspec.yaml` takes too, runs out of
stack by that and takes the process with it; events come without recursion, so that what is nested too deep
is refused before anything is made of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import yaml

MAX_LEVELS = 64
"""Levels."""

_LOADER: type[yaml.BaseLoader] = getattr(yaml, "CBaseLoader", yaml.BaseLoader)


class YamlError(ValueError):
    """This is no YAML, or too deep.

    Attributes:
        problem: one clause.
        line: from 1; 0 where it is not known.
        column: from 1; 0 where it is not known.
    """

    def __init__(self, problem: str, mark: Any = None) -> None:
        super().__init__(problem)
        self.problem = problem
        self.line = mark.line + 1 if mark else 0
        self.column = mark.column + 1 if mark else 0


def yaml_events(data: bytes | str) -> Iterator[yaml.Event]:
    """Yield the events of a stream of documents; scalars are text.

    Raises:
        YamlError: this is no YAML, or more than `MAX_LEVELS` levels.
    """
    depth = 0
    try:
        for event in yaml.parse(data, Loader=_LOADER):
            if isinstance(event, yaml.CollectionStartEvent):
                depth += 1
                if depth > MAX_LEVELS:
                    raise YamlError(f"more than {MAX_LEVELS} levels", event.start_mark)
            elif isinstance(event, yaml.CollectionEndEvent):
                depth -= 1
            yield event
    except yaml.MarkedYAMLError as error:
        raise YamlError(f"this is no YAML: {error.problem}", error.problem_mark) from error
    except (yaml.YAMLError, UnicodeError) as error:
        raise YamlError(f"this is no YAML: {' '.join(str(error).split())}") from error
