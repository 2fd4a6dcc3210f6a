"""Texts of the tables of the protocol: each has a translation under its own code, and none is left over."""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope.messages.message import Message
from bcapscope.protocol.slave_mode.modes import MODES
from bcapscope.protocol.tables.hresult import describe_hresult
from bcapscope.protocol.tables.table_rows import table_rows
from tests.messages.test_catalogue import ENGLISH, JAPANESE

ONLY_JAPANESE = set(JAPANESE) - set(ENGLISH)


def table_ids(message: Message | None) -> Iterator[str]:
    """Yield the ids of a message, and of those that stand in its places, whose English is in a table."""
    if message is None:
        return
    if message.english is not None:
        yield message.id
    for value in message.places.values():
        if isinstance(value, Message):
            yield from table_ids(value)


def test_each_result_code_is_translated() -> None:
    codes: list[int] = []
    for digits in (row["code"] for row in table_rows("hresults")):
        first, _, last = digits.replace("x", "1").partition("-")
        span = range(int(first, 16), int(last or first, 16) + 1)
        codes.append(next(code for code in span if not (last and describe_hresult(code).is_listed)))
    found: set[str] = set()
    for result in map(describe_hresult, codes):
        found.update(table_ids(result.meaning), table_ids(result.advice))
    assert found == {name for name in ONLY_JAPANESE if name.startswith("hresult.")}


def test_each_slave_mode_is_translated() -> None:
    found = {each for mode in MODES for each in table_ids(mode.description)}
    assert found == {name for name in ONLY_JAPANESE if name.startswith("slave-mode.")}
