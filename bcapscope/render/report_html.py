"""Pieces of HTML; whatever goes in as text comes out as text, wherever it was from."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from typing import NewType

from bcapscope.render.escape import printable

Html = NewType("Html", str)
"""Text that is HTML already, and harmless."""


def escaped(text: object) -> Html:
    """Make plain text of anything: control characters become visible, HTML loses its meaning.

    Fit for the content of elements and for attributes in double quotes.
    """
    return Html(html.escape(printable(str(text))))


def joined(pieces: Iterable[Html]) -> Html:
    """Put pieces one behind the other."""
    return Html("".join(pieces))


def element(name: str, content: Html, **attributes: str) -> Html:
    """Write an element; its attributes are plain text.

    A trailing underscore of an attribute's name is dropped, others become hyphens.
    """
    words = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escaped(value)}"' for key, value in attributes.items()
    )
    return Html(f"<{name}{words}>{content}</{name}>")


def paragraph(text: str, kind: str = "") -> Html:
    """Write a paragraph of plain text."""
    return element("p", escaped(text), class_=kind) if kind else element("p", escaped(text))


def table(caption: str, header: Sequence[str], rows: Sequence[Sequence[Html]], numbers: str) -> Html:
    """Write a table.

    Args:
        caption: says what it holds, in plain text.
        header: names of the columns, in plain text.
        rows: as many cells each.
        numbers: for each column ``>`` where it holds numbers, else ``<``.
    """
    sides = ["n" if side == ">" else "t" for side in numbers]
    head = joined(
        element("th", escaped(name), scope="col", class_=side)
        for name, side in zip(header, sides, strict=True)
    )
    body = joined(
        element("tr", joined(element("td", cell, class_=side) for cell, side in zip(row, sides, strict=True)))
        for row in rows
    )
    inside = joined(
        (
            element("caption", escaped(caption)),
            element("thead", element("tr", head)),
            element("tbody", body),
        )
    )
    return element("div", element("table", inside), class_="wide", tabindex="0")


def facts(pairs: Iterable[tuple[str, Html]]) -> Html:
    """Write a list of names and what they stand for."""
    return element(
        "dl",
        joined(
            element("div", Html(element("dt", escaped(name)) + element("dd", value))) for name, value in pairs
        ),
    )
