"""YAML as lists, dictionaries and text, without recursion; all scalars, even numbers, stay text.

PyYAML's loaders first build a node for each value. For a trajectory of 140,000 values, these nodes took 71 MB
more memory, and reading took four times as long (PyYAML 6, libyaml).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import yaml

from bcapscope.faults.yaml_events import YamlError, yaml_events
from bcapscope.messages import Message
from bcapscope.player.trajectory import TrajectoryError
from bcapscope.player.trajectory_documents import MAX_VALUES, TOO_MANY_VALUES


def read_yaml(data: bytes) -> Iterator[object]:
    """Yield the documents; raise TrajectoryError if the data is no YAML or is nested too deeply."""
    builder = _DocumentBuilder()
    try:
        for event in yaml_events(data):
            if isinstance(event, yaml.DocumentStartEvent):
                builder = _DocumentBuilder()
            elif isinstance(event, yaml.DocumentEndEvent):
                yield builder.root
            else:
                builder.add_event(event)
    except YamlError as error:
        raise TrajectoryError(error.message, error.line or None, error.column or None) from error


class _DocumentBuilder:
    """Builds a document from parser events; `root` is complete after the last event."""

    def __init__(self) -> None:
        self.root: object = None
        self._open: list[list[Any] | dict[str, Any]] = []
        self._keys: list[str | None] = []  # key of the next value, for each open mapping
        self._anchors: dict[str, object] = {}
        self._values = 0

    def add_event(self, event: yaml.Event) -> None:
        """Process a parser event of a document; ignore events of the stream itself."""
        if isinstance(event, yaml.ScalarEvent):
            self._add_node(event.value, event)
        elif isinstance(event, yaml.AliasEvent):
            if event.anchor not in self._anchors:
                raise TrajectoryError(Message("yaml.unknown-anchor", anchor=str(event.anchor)), _line(event))
            self._add_node(self._anchors[event.anchor], event)
        elif isinstance(event, yaml.CollectionStartEvent):
            node: list[Any] | dict[str, Any] = {} if isinstance(event, yaml.MappingStartEvent) else []
            self._add_node(node, event)
            self._open.append(node)
            self._keys.append(None)
        elif isinstance(event, yaml.CollectionEndEvent):
            self._open.pop()
            self._keys.pop()

    def _add_node(self, node: object, event: yaml.NodeEvent) -> None:
        self._values += 1
        if self._values > MAX_VALUES:
            raise TrajectoryError(TOO_MANY_VALUES, _line(event))
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
