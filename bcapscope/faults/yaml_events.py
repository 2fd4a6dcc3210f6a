"""Reads YAML as a sequence of events. bcapscope reads all its YAML input with this module.

The composers of PyYAML and `msgspec.yaml` call themselves for each level of nesting, so deep input
overflows the stack and crashes the process. `yaml_events` needs no recursion, and rejects deep input.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import yaml

from bcapscope.errors import InputError
from bcapscope.messages import Message

MAX_LEVELS = 64

_DEPTH_PROBLEM = "exceeded maximum nesting depth"
"""libyaml from 0.2.6 on reports this problem when it reads ahead more than 1,000 levels."""

_LOADER: type[yaml.BaseLoader] = getattr(yaml, "CBaseLoader", yaml.BaseLoader)


class YamlError(InputError):
    """The text is not YAML, or is nested too deep. `line` and `column` count from 1, and are 0 if unknown."""

    def __init__(self, reason: Message, mark: Any = None) -> None:
        super().__init__(reason)
        self.line = mark.line + 1 if mark else 0
        self.column = mark.column + 1 if mark else 0


def _too_deep() -> Message:
    return Message("yaml.too-deep", levels=MAX_LEVELS)


def yaml_events(data: bytes | str) -> Iterator[yaml.Event]:
    """Yield the events of a stream of YAML documents, with all scalars as text. If the data is not YAML, or
    has more than `MAX_LEVELS` levels, raise a `YamlError`.
    """
    depth = 0
    try:
        for event in yaml.parse(data, Loader=_LOADER):
            if isinstance(event, yaml.CollectionStartEvent):
                depth += 1
                if depth > MAX_LEVELS:
                    raise YamlError(_too_deep(), event.start_mark)
            elif isinstance(event, yaml.CollectionEndEvent):
                depth -= 1
            yield event
    except yaml.MarkedYAMLError as error:
        is_too_deep = error.problem == _DEPTH_PROBLEM
        reason = _too_deep() if is_too_deep else Message("yaml.invalid", reason=str(error.problem))
        raise YamlError(reason, error.problem_mark) from error
    except (yaml.YAMLError, UnicodeError) as error:
        raise YamlError(Message("yaml.invalid", reason=" ".join(str(error).split()))) from error
