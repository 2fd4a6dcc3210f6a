"""Pieces of HTML: what goes in as text comes out as text."""

from __future__ import annotations

import html
from html.parser import HTMLParser

from hypothesis import given
from hypothesis import strategies as st

from bcapscope.render.escape import printable
from bcapscope.render.report_html import (
    Html,
    definition_list,
    element,
    escape_html,
    html_table,
    join_html,
    paragraph,
)


class Reader(HTMLParser):
    """Reads elements, attributes and text as a browser does."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[str] = []
        self.values: list[str | None] = []
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.values += [value for _, value in attrs]

    def handle_data(self, data: str) -> None:
        self.text += data


@given(st.text())
def test_any_text_is_text(text: str) -> None:
    read = Reader(paragraph(text))
    assert read.tags == ["p"]
    assert read.text == printable(text)


@given(st.text())
def test_any_attribute_is_one(text: str) -> None:
    read = Reader(element("a", Html(""), href=text, class_="x"))
    assert (read.tags, read.values, read.text) == (["a"], [printable(text), "x"], "")


def test_names_of_attributes() -> None:
    assert element("p", Html("y"), class_="a", aria_label="b") == '<p class="a" aria-label="b">y</p>'


def test_a_table_has_its_caption_and_sides() -> None:
    made = html_table("All <of> it.", ("name", "n"), [[escape_html("a&b"), escape_html(3)]], "<>")
    assert "<caption>All &lt;of&gt; it.</caption>" in made
    assert '<th scope="col" class="t">name</th><th scope="col" class="n">n</th>' in made
    assert '<td class="t">a&amp;b</td><td class="n">3</td>' in made


def test_facts_are_a_list_of_definitions() -> None:
    made = definition_list([("a", escape_html("1")), ("b", join_html((escape_html("<"), Html("<b>2</b>"))))])
    assert made == ("<dl><div><dt>a</dt><dd>1</dd></div><div><dt>b</dt><dd>&lt;<b>2</b></dd></div></dl>")


def test_control_characters_become_visible() -> None:
    assert html.unescape(escape_html("\x1b[2J\u202e\n")) == "\\x1b[2J\\u202e\\n"
