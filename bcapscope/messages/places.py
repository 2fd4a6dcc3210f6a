"""Typed values for the places of messages. Each knows its text in a language and its JSON."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from bcapscope.messages.message import Json, Message, MessageFormatter, Place

LONGEST_TEXT = 60
"""Characters of a string from the wire that a sentence shows."""

_MS = 1_000_000


def duration_text(nanoseconds: int) -> str:
    """Format a duration in ms or s with two or three significant digits."""
    ms = nanoseconds / _MS
    if ms >= 999.5:
        return f"{ms / 1000:.3g} s" if ms < 999_500 else f"{ms / 1000:.0f} s"
    if ms >= 9.95:
        return f"{ms:.0f} ms"
    return f"{ms:.1f} ms" if ms >= 0.095 else f"{ms:.2f} ms"


def amount_text(value: float) -> str:
    """Format a measured number with three significant digits, or with all digits before the decimal point."""
    return f"{value:.0f}" if 999.5 <= abs(value) < 1e9 else f"{value:.3g}"


@dataclass(frozen=True, slots=True)
class Duration(Place):
    """A duration in ns; negative ones count too."""

    ns: int
    type_name: ClassVar[str] = "duration"

    def text(self, words: MessageFormatter) -> str:
        return duration_text(self.ns)

    def to_json(self) -> Json:
        return {"type": "duration", "ms": self.ns / _MS}


@dataclass(frozen=True, slots=True)
class Moment(Place):
    """A time in ns since 1970; sentences count it in seconds from the start of the traffic."""

    ns: int
    type_name: ClassVar[str] = "time"

    def text(self, words: MessageFormatter) -> str:
        return f"{(self.ns - words.start) / 1e9:.3f} s"

    def to_json(self) -> Json:
        return {"type": "time", "ns": self.ns}


@dataclass(frozen=True, slots=True)
class Quantity(Place):
    """A measured number with its unit, such as `12.5 deg`.

    Attributes:
        value: The number.
        unit: Its unit; "" for a bare number.
        decimals: Digits after the decimal point; None for three significant digits.
    """

    value: float
    unit: str = ""
    decimals: int | None = None
    type_name: ClassVar[str] = "quantity"

    def text(self, words: MessageFormatter) -> str:
        number = amount_text(self.value) if self.decimals is None else f"{self.value:.{self.decimals}f}"
        return f"{number}%" if self.unit == "%" else f"{number} {self.unit}".rstrip()

    def to_json(self) -> Json:
        return {"type": "quantity", "value": self.value, "unit": self.unit}


@dataclass(frozen=True, slots=True)
class HexNumber(Place):
    """A number that the field writes in hex, such as a result code without its meaning, or a slave mode."""

    value: int
    digits: int = 8
    type_name: ClassVar[str] = "hex"

    def text(self, words: MessageFormatter) -> str:
        return f"0x{self.value:0{self.digits}X}"

    def to_json(self) -> Json:
        return {"type": "hex", "value": self.value}


@dataclass(frozen=True, slots=True)
class Measured(Place):
    """A number with its unit and a chosen precision, such as `1234.56 deg`; unit "" for a bare number."""

    value: float
    unit: str = ""
    digits: int = 6
    type_name: ClassVar[str] = "measured"

    def text(self, words: MessageFormatter) -> str:
        return f"{self.value:.{self.digits}g} {self.unit}".rstrip()

    def to_json(self) -> Json:
        return {"type": "quantity", "value": self.value, "unit": self.unit}


@dataclass(frozen=True, slots=True)
class Count(Place):
    """A number of things, with the plural that the language wants.

    Attributes:
        number: How many.
        unit: Thing that is counted: the id `count.<unit>` of the catalogue.
    """

    number: int
    unit: str
    type_name: ClassVar[str] = "count"

    def text(self, words: MessageFormatter) -> str:
        return words.plural(f"count.{self.unit}", self.number)

    def to_json(self) -> Json:
        return {"type": "count", "value": self.number, "unit": self.unit}


@dataclass(frozen=True, slots=True)
class Times(Place):
    """How often something happened: once, twice, 3 times."""

    number: int
    type_name: ClassVar[str] = "times"

    def text(self, words: MessageFormatter) -> str:
        return words.plural("times", self.number) if self.number != 2 else words("times.twice")

    def to_json(self) -> Json:
        return {"type": "count", "value": self.number, "unit": "times"}


@dataclass(frozen=True, slots=True)
class CodePlace(Place):
    """A result code.

    Attributes:
        code: The code, unsigned.
        name: The vendor's symbol, or the code in hex.
        meaning: What the code means.
    """

    code: int
    name: str
    meaning: Message
    type_name: ClassVar[str] = "code"

    def text(self, words: MessageFormatter) -> str:
        number = f"0x{self.code:08X}"
        symbol = number if self.name == number else f"{self.name} {number}"
        return f"{symbol}, {words.text(self.meaning)}"

    def to_json(self) -> Json:
        return {"type": "code", "hresult": self.code, "name": self.name, "meaning": str(self.meaning)}


@dataclass(frozen=True, slots=True)
class FramePlace(Place):
    """One or more frames by their numbers in the traffic."""

    numbers: tuple[int, ...]
    type_name: ClassVar[str] = "frames"

    def text(self, words: MessageFormatter) -> str:
        return ", ".join(map(str, self.numbers))

    def to_json(self) -> Json:
        return {"type": "frames", "frames": list(self.numbers)}


@dataclass(frozen=True, slots=True)
class CallPlace(Place):
    """A call.

    Attributes:
        name: Its command, or its function if it has none.
        serial: Serial of its first attempt; None to show the name only.
        number: Its number in the traffic.
    """

    name: str
    serial: int | None
    number: int
    type_name: ClassVar[str] = "call"

    def text(self, words: MessageFormatter) -> str:
        name = shortened(self.name)
        return name if self.serial is None else f"{name} {self.serial}"

    def to_json(self) -> Json:
        return {"type": "call", "name": self.name, "serial": self.serial, "call": self.number}


@dataclass(frozen=True, slots=True)
class ClientPlace(Place):
    """A client. In templates, ``{client:Client}`` begins a sentence.

    Attributes:
        address: Host and port as text.
        transport: Transport as lower-case text.
    """

    address: str
    transport: str
    type_name: ClassVar[str] = "client"

    def text(self, words: MessageFormatter) -> str:
        if words.only_client:
            return words("client.only")
        return words("client.named", address=self.address, transport=self.transport.upper())

    def to_json(self) -> Json:
        return {"type": "client", "address": self.address, "transport": self.transport}


@dataclass(frozen=True, slots=True)
class WireText(Place):
    """A string from the wire, shortened in sentences. It is escaped where it is shown, not here."""

    value: str
    type_name: ClassVar[str] = "text"

    def text(self, words: MessageFormatter) -> str:
        return shortened(self.value)

    def to_json(self) -> Json:
        return self.value


@dataclass(frozen=True, slots=True)
class Listing(Place):
    """Several messages or strings in a row; the last one follows "and"."""

    items: tuple[Message | str, ...]
    type_name: ClassVar[str] = "list"

    def text(self, words: MessageFormatter) -> str:
        texts = [each if isinstance(each, str) else words.text(each) for each in self.items]
        if len(texts) < 2:
            return "".join(texts)
        return words("list.and", items=words("list.comma").join(texts[:-1]), last=texts[-1])

    def to_json(self) -> Json:
        return [str(each) for each in self.items]


@dataclass(frozen=True, slots=True)
class Enumeration(Place):
    """Several messages in a row, all separated alike."""

    items: tuple[Message, ...]
    type_name: ClassVar[str] = "enumeration"

    def text(self, words: MessageFormatter) -> str:
        return words("list.comma").join(map(words.text, self.items))

    def to_json(self) -> Json:
        return [str(each) for each in self.items]


@dataclass(frozen=True, slots=True)
class Clauses(Place):
    """Several messages in a row, separated by semicolons."""

    items: tuple[Message, ...]
    type_name: ClassVar[str] = "clauses"

    def text(self, words: MessageFormatter) -> str:
        return words("list.semicolon").join(map(words.text, self.items))

    def to_json(self) -> Json:
        return [str(each) for each in self.items]


def joined_clauses(clauses: Iterable[Message]) -> Message | None:
    """Return clauses as one message, each once; None if there are none."""
    items = tuple(dict.fromkeys(clauses))
    if len(items) < 2:
        return items[0] if items else None
    return Message("list.clauses", items=Clauses(items))


@dataclass(frozen=True, slots=True)
class IndentedLines(Place):
    """Several messages, each on a line of its own below the sentence."""

    items: tuple[Message, ...]
    type_name: ClassVar[str] = "lines"

    def text(self, words: MessageFormatter) -> str:
        return "".join(f"\n  {words.text(each)}" for each in self.items)

    def to_json(self) -> Json:
        return [str(each) for each in self.items]


def shortened(text: str) -> str:
    """Return at most `LONGEST_TEXT` characters, with … for the rest."""
    return text if len(text) <= LONGEST_TEXT else text[:LONGEST_TEXT] + "…"
