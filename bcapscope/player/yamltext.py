"""YAML as lists, dictionaries and text, without recursion, so that no nesting is too deep to be refused.

PyYAML's own composer calls itself for each level, and its fast one in C runs out of stack and takes the
process with it. Its events come one after the other; numbers and all other scalars stay text.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import yaml

from bcapscope.player.trajectory import TrajectoryError

DEEPEST = 64
"""Levels."""

_LOADER: type[yaml.BaseLoader] = getattr(yaml, "CBaseLoader", yaml.BaseLoader)


def read_yaml(data: bytes) -> Iterator[object]:
    """Yield the documents.

    Raises:
        TrajectoryError: this is no YAML, or nested too deep.
    """
    try:
        yield from _documents(data)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = (mark.line + 1, mark.column + 1) if mark else (None, None)
        raise TrajectoryError(f"this is no YAML: {error.problem}", *place) from error
    except (yaml.YAMLError, UnicodeError) as error:
        raise TrajectoryError(f"this is no YAML: {' '.join(str(error).split())}") from error


def _documents(data: bytes) -> Iterator[object]:
    builder = _Builder()
    for event in yaml.parse(data, Loader=_LOADER):
        if isinstance(event, yaml.DocumentStartEvent):
            builder = _Builder()
        elif isinstance(event, yaml.DocumentEndEvent):
            yield builder.root
        else:
            builder.take(event)


class _Builder:
    """Makes a document of events.

    Attributes:
        root: the document, complete once its events are.
    """

    def __init__(self) -> None:
        self.root: object = None
        self._open: list[list[Any] | dict[str, Any]] = []
        self._keys: list[str | None] = []  # of each open mapping, the key whose value comes next
        self._anchors: dict[str, object] = {}

    def take(self, event: yaml.Event) -> None:
        """Take an event of a document in; those of the stream itself are ignored."""
        if isinstance(event, yaml.ScalarEvent):
            self._add(event.value, event)
        elif isinstance(event, yaml.AliasEvent):
            if event.anchor not in self._anchors:
                raise TrajectoryError(f"this is no YAML: *{event.anchor} refers to nothing", _line(event))
            self._add(self._anchors[event.anchor], event)
        elif isinstance(event, yaml.CollectionStartEvent):
            node: list[Any] | dict[str, Any] = {} if isinstance(event, yaml.MappingStartEvent) else []
            self._add(node, event)
            self._open.append(node)
            self._keys.append(None)
            if len(self._open) > DEEPEST:
                raise TrajectoryError(f"more than {DEEPEST} levels", _line(event))
        elif isinstance(event, yaml.CollectionEndEvent):
            self._open.pop()
            self._keys.pop()

    def _add(self, node: object, event: yaml.NodeEvent) -> None:
        if event.anchor and not isinstance(event, yaml.AliasEvent):
            self._anchors[event.anchor] = node
        if not self._open:
            self.root = node
            return
        place = self._open[-1]
        if isinstance(place, list):
            place.append(node)
        elif self._keys[-1] is None:
            self._keys[-1] = node if isinstance(node, str) else "?"
        else:
            place[self._keys[-1]] = node
            self._keys[-1] = None


def _line(event: yaml.Event) -> int | None:
    return event.start_mark.line + 1 if event.start_mark else None
