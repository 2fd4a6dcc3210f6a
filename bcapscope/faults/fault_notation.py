"""Write a fault in one line: ``delay=3ms±1ms request times 5 if command == slvMove``.

Write the action first, with its main value after ``=``:

    loss=5%                 lose this share of messages
    drop                    lose all messages
    delay=3ms±1ms           delay by this time, plus or minus a jitter (also +-)
    duplicate=2             send this many more copies
    reorder=1               let this many later messages overtake
    corrupt=1               flip this many bits
    truncate=20             keep only this many bytes
    garbage=64              send this many random bytes instead
    burst=1%/25%            lose bursts: probability that one begins / ends
    bandwidth=64kbit/s      limit the rate; also kB/s
    partition               let nothing through while the fault is active
    half-open               let nothing more through in this conversation
    pass                    forward the message, and skip all later faults
    answer=E_FAIL           answer with this HRESULT; do not forward the request
    serial=1                add this to the serial of a reply
    executing=2s            send S_EXECUTING notices this long, then the reply
    close=reset             close the TCP connection; also fin
    rewrite                 change serial, reserved or code, or arguments with
                            set, limit or step

After the action, write other fields in any order, for example to select messages:

    request  response       only this direction; reply means response
    5%                      with this probability
    try 1                   only the first attempt of a call, or its reply
    times 3                 at most this often
    after 2s  for 10s       begin after this time; end after this duration
    name lossy              name for reports
    distribution normal     of the jitter: uniform, normal, pareto
    set arg[2][0]=10        limit arg[2]=-90..90   step arg[2]=0.5

If you write a condition, write it last: ``if`` and a filter. `bcapscope fields` explains filters.

In a YAML file, every value needs the name of its field:

    faults:
      - {action: drop, probability: 5%, direction: response, try: 1}
      - {action: delay, time: 3ms, jitter: 1ms, times: 5, if: command == slvMove}

This list names an action, then the YAML fields that hold the action's main value:

    duplicate copies   reorder by       corrupt bits     truncate keep   garbage size
    burst enter leave  bandwidth rate   answer hresult   serial by       executing time
    close how
"""

from __future__ import annotations

import json
import re
from typing import Any, NamedTuple, NoReturn

from bcapscope.faults.document import DocumentError, fault_from, to_plain_data
from bcapscope.faults.fault import Fault
from bcapscope.faults.fault_kinds import ACTIONS, ALIASES, AnyFault, RewriteFault
from bcapscope.faults.rewriter import Rewriter
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame, parse_datagram
from bcapscope.protocol.number_parsing import LONGEST_NUMBER
from bcapscope.traffic.filter.tokens import FilterError, with_nearest
from bcapscope.traffic.observation import Flow

_WORD = re.compile(r'(?:"(?:[^"\\]|\\.)*"|[^\s"])+')
_INTEGER = re.compile(r"[-+]?[0-9]+")
_NUMBER = re.compile(r"[-+]?[0-9]+(?:\.[0-9]+)?(?:[eE][-+]?[0-9]+)?")
_PLUS_MINUS = re.compile(r"±|\+-")

_MAIN_FIELDS: dict[str, tuple[str, ...]] = {
    "loss": ("probability",),
    "delay": ("time", "jitter"),
    "duplicate": ("copies",),
    "reorder": ("by",),
    "corrupt": ("bits",),
    "truncate": ("keep",),
    "garbage": ("size",),
    "serial": ("by",),
    "answer": ("hresult",),
    "executing": ("time",),
    "close": ("how",),
    "burst": ("enter", "leave"),
    "bandwidth": ("rate",),
}
"""Maps an action to the fields that its main value sets, such as ``time`` and ``jitter`` for ``delay``."""

_SEPARATORS = {"delay": "±", "burst": "/"}
_DIRECTIONS = {"request": "request", "response": "response", "reply": "response"}
_MAPPINGS = ("set", "limit", "step")


class NotationError(FilterError):
    """The text is not a valid fault. The error shows the reason, the text, and a caret under the error."""


class _Word(NamedTuple):
    text: str
    start: int


def read_fault(text: str) -> AnyFault:
    """Parse a fault. Invalid text raises a `NotationError`."""
    return _FaultParser(text).read()


def write_fault(fault: Fault) -> str:
    """Return a fault as text. If `read_fault` reads this text, it returns an equal fault."""
    fields = to_plain_data(fault)
    action = fields.pop("action")
    main = [fields.pop(name) for name in _MAIN_FIELDS.get(action, ()) if name in fields]
    words = [action + ("=" + _SEPARATORS.get(action, "").join(map(_format_value, main)) if main else "")]
    condition = fields.pop("if", None)
    for name, value in fields.items():
        if value and name in ("direction", "probability"):
            words.append(value)
        elif name in _MAPPINGS:
            words += [f"{name} {path}={_format_value(each)}" for path, each in value.items()]
        else:
            words.append(f"{name} {_format_value(value)}")
    if condition is not None:
        words.append(f"if {condition}")
    return " ".join(words)


def rewrite_message(data: bytes, flow: Flow, changes: str) -> bytes:
    """Return a message with changes such as ``set arg[2]=0 serial 7``; if nothing changes, return the same
    bytes. An invalid notation raises a `ValueError`.
    """
    fault = read_fault(f"rewrite {changes}")
    assert isinstance(fault, RewriteFault)
    rewriter = Rewriter(fault)
    return b"".join(
        rewriter.rewrite(item, flow) if isinstance(item, Frame) else item.raw for item in parse_datagram(data)
    )


def _format_value(value: object) -> str:
    if isinstance(value, str):
        plainly = _WORD.fullmatch(value) and '"' not in value and not _NUMBER.fullmatch(value)
        return value if plainly and value not in ("true", "false", "any", "if") else json.dumps(value)
    return "any" if value is None else str(value).lower()


class _FaultParser:
    """Collects the fields of one fault, and the position of each field in the text."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.fields: dict[str, Any] = {}
        self.starts: dict[str, int] = {}
        words = [_Word(match[0], match.start()) for match in _WORD.finditer(text)]
        stop = next((index for index, word in enumerate(words) if word.text == "if"), len(words))
        self.words = words[:stop]
        self.condition = words[stop] if stop < len(words) else None

    def read(self) -> AnyFault:
        if not self.words:
            actions = ", ".join(sorted([*ACTIONS, *ALIASES]))
            self.fail_at(0, Message("fault.no-action", actions=actions))
        self.words.reverse()
        self.read_action(self.words.pop())
        while self.words:
            self.read_word(self.words.pop())
        if self.condition is not None:
            start = self.condition.start + len("if")
            self.set_field("if", self.text[start:].strip(), self.condition)
        try:
            return fault_from(self.fields)
        except DocumentError as error:
            raise self.locate_error(error) from error

    def read_action(self, word: _Word) -> None:
        written, equals, value = word.text.partition("=")
        action = ALIASES.get(written, written)
        if action not in ACTIONS:
            unknown = Message("fault.no-such-action", name=f"{written!r}")
            self.fail_at(word.start, with_nearest(unknown, written, [*ACTIONS, *ALIASES]))
        self.set_field("action", action, word)
        names = _MAIN_FIELDS.get(written, ())
        start = word.start + len(written) + 1
        if equals and not names:
            self.fail_at(start - 1, Message("fault.needless-value", name=written))
        if not equals and written in ALIASES:
            self.fail_at(word.start + len(written), Message("fault.no-equals", name=written))
        if equals:
            self.read_main(written, _Word(value, start), names)

    def read_main(self, written: str, word: _Word, names: tuple[str, ...]) -> None:
        end = word.start + len(word.text)
        text = _PLUS_MINUS.sub("±", word.text) if written == "delay" else word.text
        separator = _SEPARATORS.get(written)
        values = text.split(separator) if separator else [text]
        if len(values) > len(names):
            self.fail_at(word.start, Message("fault.too-many-values", names=(separator or "").join(names)))
        # Here are at most two values: one at the start of the word, and one at its end.
        for name, value, start in zip(names, values, (word.start, end - len(values[-1])), strict=False):
            self.set_field(name, self.parse_value(value, start), _Word(value, start))

    def read_word(self, word: _Word) -> None:
        fields = ACTIONS[self.fields["action"]].__struct_encode_fields__
        if word.text in _DIRECTIONS:
            self.set_field("direction", _DIRECTIONS[word.text], word)
        elif word.text.endswith("%"):
            self.set_field("probability", word.text, word)
        elif word.text in fields and word.text != "if":
            self.read_field(word)
        else:
            known = [*fields, *_DIRECTIONS]
            unknown = Message("input.meaningless", text=f"{word.text!r}")
            self.fail_at(word.start, with_nearest(unknown, word.text, known))

    def read_field(self, name: _Word) -> None:
        if not self.words:
            self.fail_at(len(self.text), Message("fault.no-value", name=name.text))
        word = self.words.pop()
        if name.text not in _MAPPINGS:
            self.set_field(
                name.text, self.parse_value(word.text, word.start, is_text=name.text == "name"), word
            )
            return
        path, equals, value = word.text.partition("=")
        if not equals:
            self.fail_at(word.start, Message("fault.no-argument", name=name.text))
        mapping = self.fields.setdefault(name.text, {})
        self.starts.setdefault(name.text, word.start)
        if path in mapping:
            self.fail_at(word.start, Message("input.twice", name=f"{name.text} {path}"))
        mapping[path] = self.parse_value(value, word.start + len(path) + 1)

    def parse_value(self, text: str, start: int, is_text: bool = False) -> object:
        """Convert a word to a number, a boolean, None or text."""
        if text.startswith('"'):
            try:
                return json.loads(text)
            except ValueError:
                self.fail_at(start, Message("fault.quotes"))
        if is_text:
            return text
        if _NUMBER.fullmatch(text):
            if len(text) > LONGEST_NUMBER:
                self.fail_at(start, Message("input.long-number", limit=LONGEST_NUMBER))
            return int(text) if _INTEGER.fullmatch(text) else float(text)
        return {"true": True, "false": False, "any": None}.get(text, text)

    def set_field(self, name: str, value: object, word: _Word) -> None:
        if name in self.fields:
            self.fail_at(word.start, Message("input.twice", name=name))
        self.fields[name] = value
        self.starts[name] = word.start

    def fail_at(self, start: int, reason: Message) -> NoReturn:
        raise NotationError(self.text, start, reason)

    def locate_error(self, error: DocumentError) -> NotationError:
        """Convert an error in a field into an error that shows where the field is in the text."""
        cause = error.__cause__.__cause__ if error.__cause__ else None
        if isinstance(cause, FilterError):
            shift = self.text.index(cause.expression, self.starts["if"] + len("if"))
            return NotationError(self.text, shift + cause.position, cause.reason)
        start = self.starts[str(error.path[0])] if error.path else 0
        if not error.path and error.reason.id == "document.missing":
            stop = self.condition.start if self.condition else len(self.text)
            return NotationError(self.text, len(self.text[:stop].rstrip()), error.reason)
        return NotationError(self.text, start, error.reason)
