"""Text for times, clients and calls, the same in all sentences."""

from __future__ import annotations

from collections.abc import Callable

from bcapscope.messages import Message, MessageFormatter
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.protocol.tables.hresult import describe_hresult, hresult_name
from bcapscope.traffic.call import Call
from bcapscope.traffic.observation import Conversation

LONGEST_NAME = 60
"""Characters of a string from the wire that a sentence shows."""

_MS = 1_000_000


def shown(text: str) -> str:
    """Shorten a string from the wire. The result is not escaped."""
    return text if len(text) <= LONGEST_NAME else text[:LONGEST_NAME] + "…"


def span(nanoseconds: int) -> str:
    """Format a duration in ms or s with two or three significant digits."""
    ms = nanoseconds / _MS
    if ms >= 999.5:
        return f"{ms / 1000:.3g} s" if ms < 999_500 else f"{ms / 1000:.0f} s"
    if ms >= 9.95:
        return f"{ms:.0f} ms"
    return f"{ms:.1f} ms" if ms >= 0.095 else f"{ms:.2f} ms"


def amount(value: float) -> str:
    """Format a measured number with three significant digits, or with all digits before the decimal point."""
    return f"{value:.0f}" if 999.5 <= abs(value) < 1e9 else f"{value:.3g}"


def times(count: int) -> str:
    """Return a count as "once", "twice" or "3 times"."""
    return {1: "once", 2: "twice"}.get(count, f"{count} times")


def name_of(call: Call) -> str:
    """Return the command of a call, or its function if it has none."""
    command = call.kind.command
    return function_name(call.kind.function_id) if command is None else shown(command)


def called(call: Call) -> str:
    """Return the name of a call and its first serial."""
    return f"{name_of(call)} {call.request.item.serial}"


def result_text(code: int) -> str:
    """Return name, number and description of a result code."""
    name, number = hresult_name(code), f"0x{code:08X}"
    symbol = number if name == number else f"{name} {number}"
    return f"{symbol}, {describe_hresult(code).text}"


class Speech:
    """Formats times and clients for the sentences of one report."""

    def __init__(self, start: int, alone: bool) -> None:
        """Create a formatter.

        Args:
            start: Time when the traffic began, ns since 1970. Times count from there, as in `decode` and
                `calls`.
            alone: True if there is only one client; it is then called "your client".
        """
        self._start = start
        self._alone = alone

    def at(self, time: int) -> str:
        """Return a time as seconds since the traffic began."""
        return f"{(time - self._start) / 1e9:.3f} s"

    def client(self, conversation: Conversation) -> str:
        """Return the name of a client."""
        if self._alone:
            return "your client"
        return f"client {conversation.client} ({conversation.transport.upper()})"


class SpokenMessage(Message):
    """A sentence that a rule still makes in English; it goes once all rules emit data."""

    __slots__ = ("say", "then")
    say: Callable[[Speech], str] | None
    then: Callable[[Speech, int], str] | None

    def __init__(
        self, say: Callable[[Speech], str] | None = None, then: Callable[[Speech, int], str] | None = None
    ) -> None:
        super().__init__("spoken")
        object.__setattr__(self, "say", say)
        object.__setattr__(self, "then", then)


def as_messages(
    fact: Message | Callable[[Speech], str],
    clause: Message | Callable[[Speech, int], str] | None,
    advice: Message | str | None,
) -> tuple[Message, Message | None, Message | None]:
    """Wrap what a rule still makes in English."""
    return (
        fact if isinstance(fact, Message) else SpokenMessage(say=fact),
        clause if clause is None or isinstance(clause, Message) else SpokenMessage(then=clause),
        Message.from_table("advice", advice) if isinstance(advice, str) and advice else advice or None,
    )


_OPENERS = frozenset(("the", "your", "client", "a", "at", "that", "after", "frame", "another", "slave"))


def spoken_text(message: SpokenMessage, words: MessageFormatter, after: int | None = None) -> str:
    """Return a sentence that a rule still makes in English."""
    speech = Speech(words.start, words.only_client)
    if after is not None:
        return message.then(speech, after) if message.then is not None else ""
    text = message.say(speech) if message.say is not None else ""
    first = text.split(" ", 1)[0]
    return f"{text[:1].upper() if first in _OPENERS else text[:1]}{text[1:]}."
