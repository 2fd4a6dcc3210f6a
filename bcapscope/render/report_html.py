"""Pieces of HTML; whatever goes in as text comes out as text, wherever it was from."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from typing import NewType

from bcapscope.render.escape import printable

Html = NewType("Html", str)
"""Text that is HTML already, and harmless."""


def escape_html(text: object) -> Html:
    """Make plain text of anything: control characters become visible, HTML loses its meaning.

    Fit for the content of elements and for attributes in double quotes.
    """
    return Html(html.escape(printable(str(text))))


def join_html(pieces: Iterable[Html]) -> Html:
    """Put pieces one behind the other."""
    return Html("".join(pieces))


def element(name: str, content: Html, **attributes: str) -> Html:
    """Write an element; its attributes are plain text.

    A trailing underscore of an attribute's name is dropped, others become hyphens.
    """
    words = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape_html(value)}"' for key, value in attributes.items()
    )
    return Html(f"<{name}{words}>{content}</{name}>")


def paragraph(text: str, kind: str = "") -> Html:
    """Write a paragraph of plain text."""
    return element("p", escape_html(text), class_=kind) if kind else element("p", escape_html(text))


def html_table(caption: str, header: Sequence[str], rows: Sequence[Sequence[Html]], numbers: str) -> Html:
    """Write a table.

    Args:
        caption: says what it holds, in plain text.
        header: names of the columns, in plain text.
        rows: as many cells each.
        numbers: for each column ``>`` where it holds numbers, else ``<``.
    """
    sides = ["n" if side == ">" else "t" for side in numbers]
    head = join_html(
        element("th", escape_html(name), scope="col", class_=side)
        for name, side in zip(header, sides, strict=True)
    )
    body = join_html(
        element(
            "tr", join_html(element("td", cell, class_=side) for cell, side in zip(row, sides, strict=True))
        )
        for row in rows
    )
    inside = join_html(
        (
            element("caption", escape_html(caption)),
            element("thead", element("tr", head)),
            element("tbody", body),
        )
    )
    return element("div", element("table", inside), class_="wide", tabindex="0")


def definition_list(pairs: Iterable[tuple[str, Html]]) -> Html:
    """Write a list of names and what they stand for."""
    return element(
        "dl",
        join_html(
            element("div", Html(element("dt", escape_html(name)) + element("dd", value)))
            for name, value in pairs
        ),
    )
