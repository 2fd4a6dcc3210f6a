"""Reads YAML documents, such as rule files and scenarios, into the structs that describe their fields."""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterable
from enum import Enum
from typing import Any, TypeAlias, TypeVar, cast, get_args

import msgspec
import yaml

try:
    from yaml import CSafeLoader as SafeLoader
except ImportError:  # PyYAML was built without libyaml, so it has only the slower `SafeLoader`
    from yaml import SafeLoader  # type: ignore[assignment]  # another class than `CSafeLoader`

from bcapscope.errors import InputError
from bcapscope.faults.fault_kinds import ALIASES, AnyFault
from bcapscope.faults.quantities import QUANTITIES
from bcapscope.faults.yaml_events import YamlError, yaml_events
from bcapscope.messages import Message
from bcapscope.messages.message import foreign_text
from bcapscope.protocol.number_parsing import LONGEST_NUMBER
from bcapscope.protocol.text_format import shortened
from bcapscope.traffic.filter.tokens import with_nearest

LONGEST_DOCUMENT = 1 << 20
"""Maximum number of characters of a document; people write at most ten thousand."""

T = TypeVar("T")

_Struct: TypeAlias = type[msgspec.Struct]

_AT = re.compile(r" - at (`key` in )?`([^`]*)`$")
_PATH_STEP = re.compile(r"\.([^.\[]+)|\[([0-9]+)\]")
_EXPECTED = re.compile(r"Expected `([^`]+)`, got `([^`]+)`")
_FIELD = re.compile(r"field `([^`]*)`")
_NUMBER_TAGS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")


class DocumentError(InputError):
    """A document is invalid; `message` contains line, field and `reason`.

    Attributes:
        path: Path from the top of the document to the error, as names and indexes.
        line: Line of the error, counted from 1; 0 if the data did not come from a text.
    """

    def __init__(self, path: tuple[str | int, ...], line: int, reason: Message) -> None:
        where = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path)
        message = reason
        if where:
            message = Message("document.field", field=where.removeprefix("."), reason=message)
        if line:
            message = Message("document.line", line=line, reason=message)
        super().__init__(message)
        self.path = path
        self.line = line
        self.reason = reason


class FieldError(InputError):
    """A field of a struct contradicts other fields. `path` leads from the struct to the field that the user
    must change, as names and indexes.
    """

    def __init__(self, path: tuple[str | int, ...], reason: Message) -> None:
        super().__init__(reason)
        self.path = path


class RuleFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    faults: tuple[AnyFault, ...]


def read_document(text: str, kind: type[T]) -> T:
    """Read a YAML document into a struct of type `kind`. Anchors and repeated keys are not allowed.

    The fields of the struct may have the types in `bcapscope.faults.quantities`.

    Raises:
        DocumentError: The text is not valid YAML, or its data does not match `kind`.
    """
    root, data = _parse(text)
    try:
        return cast(T, convert_data(data, kind))
    except DocumentError as error:
        raise DocumentError(error.path, _line(root, error), error.reason) from error.__cause__


def convert_data(data: object, kind: Any) -> Any:
    """Convert plain data from JSON or YAML into a struct. If the data does not match `kind`, raise a
    `DocumentError` whose `line` is 0.
    """
    try:
        return msgspec.convert(data, kind, dec_hook=_read_quantity)
    except msgspec.ValidationError as error:
        raise _document_error(error, data, kind) from error
    except RecursionError:
        raise DocumentError((), 0, Message("document.endless")) from None


def fault_from(data: object) -> AnyFault:
    """Convert plain data into a fault. Raise errors like `convert_data`."""
    return cast(AnyFault, convert_data(data, AnyFault))


def to_plain_data(value: object) -> Any:
    """Convert a struct into plain data, as in a document. Leave out fields that have their default."""
    return msgspec.to_builtins(value, enc_hook=lambda quantity: quantity.text)


def _read_quantity(kind: type, written: object) -> object:
    if kind in QUANTITIES:
        return kind.read(written)
    raise NotImplementedError(f"{kind} is no quantity")  # msgspec expects this error for an unknown type


class _Loader(SafeLoader):
    """YAML loader that rejects repeated keys, keys that are not scalars, and numbers with too many digits."""

    def construct_scalar(self, node: yaml.ScalarNode | yaml.MappingNode) -> Any:
        if node.tag in _NUMBER_TAGS and len(node.value) > LONGEST_NUMBER:
            raise YamlError(Message("input.long-number", limit=LONGEST_NUMBER), node.start_mark)
        return super().construct_scalar(node)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise YamlError(Message("yaml.key"), key.start_mark)
            if key.value in seen:
                raise YamlError(Message("input.twice", name=f"{key.value!r}"), key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def _parse(text: str) -> tuple[yaml.Node | None, object]:
    if len(text) > LONGEST_DOCUMENT:
        raise DocumentError((), 0, Message("input.too-long", limit=LONGEST_DOCUMENT))
    try:
        # reject deep nesting and aliases before YAML builds objects
        for event in yaml_events(text):
            if isinstance(event, yaml.AliasEvent):
                raise YamlError(Message("yaml.anchors"), event.start_mark)
        loader = _Loader(text)
        root = loader.get_single_node()
        return root, None if root is None else loader.construct_document(root)
    except YamlError as error:
        raise DocumentError((), error.line, error.message) from error
    except yaml.MarkedYAMLError as error:
        located = YamlError(foreign_text(str(error.problem)), error.problem_mark)
        raise DocumentError((), located.line, located.message) from error
    # PyYAML raises these errors for values that contradict their tag, and for invalid dates.
    except (ValueError, LookupError, AttributeError) as error:
        raise DocumentError((), 0, Message("yaml.invalid", reason=str(error))) from error


def _document_error(error: msgspec.ValidationError, data: object, kind: Any) -> DocumentError:
    text = str(error)
    match = _AT.search(text)
    reason = text[: match.start()] if match else text
    steps = _PATH_STEP.findall(match[2].partition("[...]")[0]) if match else []  # mapping keys are unnamed
    path: tuple[str | int, ...] = tuple(int(index) if index else name for name, index in steps)
    cause = error.__cause__
    if isinstance(cause, FieldError):
        return DocumentError((*path, *cause.path), 0, cause.message)
    if isinstance(cause, InputError):
        return DocumentError(path, 0, cause.message)
    if match and match[1]:
        return DocumentError(path, 0, Message("yaml.key"))
    return DocumentError(path, 0, _readable_reason(reason, path, data, kind))


def _readable_reason(reason: str, path: tuple[str | int, ...], data: object, kind: Any) -> Message:
    structs, types = _types_at(path, data, kind)
    field = _FIELD.search(reason)
    if field:
        return _field_reason(field[1], "missing" in reason, structs)
    wrong = data
    for step in path:
        wrong = _child(wrong, step)
    if path and path[-1] == "action" and reason.startswith("Invalid value"):
        unknown = Message("fault.no-such-action", name=_quoted(wrong))
        return with_nearest(unknown, ALIASES.get(str(wrong), str(wrong)), _actions(structs))
    if reason.startswith("Invalid enum value"):
        values = [str(each.value) for kind in types if issubclass(kind, Enum) for each in kind]
        return Message("document.none-of", value=_quoted(wrong), values=", ".join(values))
    if reason.startswith("Expected `str` matching regex"):
        return Message("fault.name")
    expected = _EXPECTED.fullmatch(reason)
    if expected:
        return Message("document.other-type", expected=expected[1], found=expected[2])
    return foreign_text(reason.replace("`", ""))


def _quoted(value: object) -> str:
    return f"{shortened(str(value), 40)!r}"


def _field_reason(name: str, is_missing: bool, structs: Iterable[_Struct]) -> Message:
    if not is_missing:
        fields = [field for struct in structs for field in struct.__struct_encode_fields__]
        unknown = Message("input.no-such-field", name=_quoted(name))
        return with_nearest(unknown, name, fields)
    missing = Message("document.missing", name=name)
    if name != "action":
        return missing
    return Message("document.missing-action", reason=missing, actions=", ".join(sorted(_actions(structs))))


def _actions(structs: Iterable[_Struct]) -> list[str]:
    return [str(struct.__struct_config__.tag) for struct in structs]


def _types_at(path: Iterable[str | int], data: object, kind: Any) -> tuple[list[_Struct], list[type]]:
    """Return the structs and the types that explain an error in the field at `path`. The types are all types
    that the field may have. If the field holds an object, the structs are the classes to which this object
    may belong. Otherwise, they are the classes of the innermost object around the field.
    """
    types = _parts(kind)
    structs = _matching_structs(types, data)
    for step in path:
        data = _child(data, step)
        if isinstance(step, str):
            types = [part for struct in structs for part in _parts(_field_type(struct, step))]
        if isinstance(data, dict):
            structs = _matching_structs(types, data) or structs
    return structs, types


def _parts(hint: Any) -> list[type]:
    """Return all classes that a type hint contains, such as the members of a union."""
    inner = [part for each in get_args(hint) for part in _parts(each)]
    return [hint, *inner] if isinstance(hint, type) else inner


def _matching_structs(types: Iterable[type], data: object) -> list[_Struct]:
    """Return the struct that the data's field ``action`` selects; all structs if the field selects none."""
    structs = [each for each in types if issubclass(each, msgspec.Struct)]
    action = data.get("action") if isinstance(data, dict) else None
    return [each for each in structs if each.__struct_config__.tag == action] or structs


def _field_type(struct: _Struct, written: str) -> Any:
    return next((each.type for each in msgspec.structs.fields(struct) if each.encode_name == written), None)


def _child(data: object, step: str | int) -> object:
    if isinstance(data, dict):
        return data.get(step)
    return data[cast(int, step)] if isinstance(data, list) else None


def _line(root: yaml.Node | None, error: DocumentError) -> int:
    node, line = root, 1 if root is None else root.start_mark.line + 1
    for step in error.path:
        if isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
            node = node.value[step]
            line = node.start_mark.line + 1
        elif isinstance(node, yaml.MappingNode):
            found = [(key, value) for key, value in node.value if key.value == step]
            if not found:
                break
            line, node = found[0][0].start_mark.line + 1, found[0][1]
    quoted = re.search(r"no field '([^']*)'", str(error.reason))
    if quoted and isinstance(node, yaml.MappingNode):
        line = next((key.start_mark.line + 1 for key, _ in node.value if key.value == quoted[1]), line)
    return line
