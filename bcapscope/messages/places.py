"""Typed values for the placeholders of messages, written as text and as JSON."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby

from bcapscope.messages.message import Json, Message, MessageFormatter, Place

LONGEST_TEXT = 60  # number of characters to show of a string from the wire

_MS = 1_000_000


def duration_text(nanoseconds: int) -> str:
    ms = nanoseconds / _MS
    if ms >= 999.5:
        return f"{ms / 1000:.3g} s" if ms < 999_500 else f"{ms / 1000:.0f} s"
    if ms >= 9.95:
        return f"{ms:.0f} ms"
    return f"{ms:.1f} ms" if ms >= 0.095 else f"{ms:.2f} ms"


def amount_text(value: float) -> str:
    """Format a number with three significant digits. Numbers from 999.5 to 1e9 become integers."""
    return f"{value:.0f}" if 999.5 <= abs(value) < 1e9 else f"{value:.3g}"


class Duration(Place):
    """A duration in ns, which may be negative."""

    type_name = "duration"

    def __init__(self, ns: int) -> None:
        self.ns = ns

    def text(self, words: MessageFormatter) -> str:
        return duration_text(self.ns)

    def to_json(self) -> Json:
        return {"type": "duration", "ms": self.ns / _MS}


class Moment(Place):
    """A time in ns since 1970. Sentences show seconds since the start of the traffic."""

    type_name = "time"

    def __init__(self, ns: int) -> None:
        self.ns = ns

    def text(self, words: MessageFormatter) -> str:
        return f"{(self.ns - words.start) / 1e9:.3f} s"


class Quantity(Place):
    """A number with a unit, such as `12.5 deg`. If `decimals` is None, `amount_text` formats the number."""

    type_name = "quantity"

    def __init__(self, value: float, unit: str = "", decimals: int | None = None) -> None:
        self.value = value
        self.unit = unit
        self.decimals = decimals

    def text(self, words: MessageFormatter) -> str:
        number = amount_text(self.value) if self.decimals is None else f"{self.value:.{self.decimals}f}"
        return f"{number}%" if self.unit == "%" else f"{number} {self.unit}".rstrip()

    def to_json(self) -> Json:
        return {"type": "quantity", "value": self.value, "unit": self.unit}


class HexNumber(Place):
    """A number that is shown in hex, such as a slave mode or a result code without its meaning."""

    type_name = "hex"

    def __init__(self, value: int, digits: int = 8) -> None:
        self.value = value
        self.digits = digits

    def text(self, words: MessageFormatter) -> str:
        return f"0x{self.value:0{self.digits}X}"

    def to_json(self) -> Json:
        return {"type": "hex", "value": self.value}


class Measured(Place):
    """A number with a unit and `digits` significant digits, such as `1234.56 deg`."""

    type_name = "measured"

    def __init__(self, value: float, unit: str = "", digits: int = 6) -> None:
        self.value = value
        self.unit = unit
        self.digits = digits

    def text(self, words: MessageFormatter) -> str:
        return f"{self.value:.{self.digits}g} {self.unit}".rstrip()

    def to_json(self) -> Json:
        return {"type": "quantity", "value": self.value, "unit": self.unit}


class Count(Place):
    """A number with a noun, such as `1 call`. The catalogue has the noun under the id `count.<unit>`."""

    type_name = "count"

    def __init__(self, value: int, unit: str) -> None:
        self.value = value
        self.unit = unit

    def text(self, words: MessageFormatter) -> str:
        return words.plural(f"count.{self.unit}", self.value)


class Times(Place):
    """How often something happened: once, twice, 3 times."""

    type_name = "times"

    def __init__(self, number: int) -> None:
        self.number = number

    def text(self, words: MessageFormatter) -> str:
        return words.plural("times", self.number) if self.number != 2 else words("times.twice")

    def to_json(self) -> Json:
        return {"type": "count", "value": self.number, "unit": "times"}


class CodePlace(Place):
    """A result code, unsigned. `name` is the vendor's name of the code, or the code in hex."""

    type_name = "code"

    def __init__(self, code: int, name: str, meaning: Message) -> None:
        self.code = code
        self.name = name
        self.meaning = meaning

    def text(self, words: MessageFormatter) -> str:
        number = f"0x{self.code:08X}"
        symbol = number if self.name == number else f"{self.name} {number}"
        return f"{symbol}, {words.text(self.meaning)}"

    def to_json(self) -> Json:
        return {"type": "code", "hresult": self.code, "name": self.name, "meaning": str(self.meaning)}


class FramePlace(Place):
    type_name = "frames"

    def __init__(self, numbers: tuple[int, ...]) -> None:
        self.numbers = numbers

    def text(self, words: MessageFormatter) -> str:
        return frames_text(self.numbers, words)

    def to_json(self) -> Json:
        return {"type": "frames", "frames": list(self.numbers)}


def frames_text(numbers: Sequence[int], words: MessageFormatter, separator: str = ", ") -> str:
    """Return frame numbers, with captures and packet numbers if `words.find_frame` is set."""
    frames, origins = separator.join(map(str, numbers)), origins_text(numbers, words)
    return f"{frames} ({origins})" if origins else frames


def origins_text(numbers: Iterable[int], words: MessageFormatter) -> str:
    """Return the captures and packet numbers of the frames, or "" if `words.find_frame` is None."""
    find_frame = words.find_frame
    if find_frame is None:
        return ""
    origins = filter(None, map(find_frame, numbers))
    return words("list.semicolon").join(
        words(f"frames.origin{'.several' if len(packets) > 1 else ''}", file=name, packets=" ".join(packets))
        for name, found in groupby(origins, lambda origin: origin[0])
        for packets in [[str(packet) for _, packet in found]]
    )


class CallPlace(Place):
    """A call, named by its command, or by its function if it has no command.

    `serial` is the serial of the first attempt, or None to show only the name. `call` is the call's number.
    """

    type_name = "call"

    def __init__(self, name: str, serial: int | None, call: int) -> None:
        self.name = name
        self.serial = serial
        self.call = call

    def text(self, words: MessageFormatter) -> str:
        name = shortened(self.name)
        return name if self.serial is None else f"{name} {self.serial}"


class ClientPlace(Place):
    """A client. At the start of a sentence, write ``{client:Client}`` in a template for a capital letter."""

    type_name = "client"

    def __init__(self, address: str, transport: str) -> None:
        self.address = address
        self.transport = transport

    def text(self, words: MessageFormatter) -> str:
        if words.only_client:
            return words("client.only")
        return words("client.named", address=self.address, transport=self.transport.upper())


class WireText(Place):
    """A string from the wire. `text` shortens the string, but does not escape control characters."""

    type_name = "text"

    def __init__(self, value: str) -> None:
        self.value = value

    def text(self, words: MessageFormatter) -> str:
        return shortened(self.value)

    def to_json(self) -> Json:
        return self.value


class Enumeration(Place):
    """Several texts in one line, separated by commas."""

    type_name = "enumeration"
    separator = "list.comma"

    def __init__(self, items: tuple[Message | str, ...]) -> None:
        self.items = items

    def texts(self, words: MessageFormatter) -> list[str]:
        return [each if isinstance(each, str) else words.text(each) for each in self.items]

    def text(self, words: MessageFormatter) -> str:
        return words(self.separator).join(self.texts(words))

    def to_json(self) -> Json:
        return [str(each) for each in self.items]


class Clauses(Enumeration):
    """Several texts in one line, separated by semicolons."""

    type_name = "clauses"
    separator = "list.semicolon"


class Listing(Enumeration):
    """Several texts in one line, with "and" before the last text."""

    type_name = "list"

    def text(self, words: MessageFormatter) -> str:
        texts = self.texts(words)
        if len(texts) < 2:
            return "".join(texts)
        return words("list.and", items=words("list.comma").join(texts[:-1]), last=texts[-1])


def joined_clauses(clauses: Iterable[Message]) -> Message | None:
    """Join clauses into one message, and leave out repeated clauses."""
    items = tuple(dict.fromkeys(clauses))
    if len(items) < 2:
        return items[0] if items else None
    return Message("list.clauses", items=Clauses(items))


class IndentedLines(Enumeration):
    """Texts that a message shows below its sentence, each text on its own line."""

    type_name = "lines"

    def text(self, words: MessageFormatter) -> str:
        return "".join(f"\n  {text}" for text in self.texts(words))


def shortened(text: str) -> str:
    return text if len(text) <= LONGEST_TEXT else text[:LONGEST_TEXT] + "…"
