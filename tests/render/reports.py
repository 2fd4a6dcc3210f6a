"""Reports of captures, taken apart."""

from __future__ import annotations

import json
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from bcapscope.analysis.report_data import ReportData, ReportDataBuilder
from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.render.report_page import report_page
from tests.traffic.playbook import run_pipeline

CAPTURES = Path(__file__).parent.parent.parent / "captures"


class Page(HTMLParser):
    """A page as a browser reads it.

    Attributes:
        tags: name and attributes of each element.
        ids: of elements.
        text: outside of scripts and styles.
        scripts: text of each script, and of each style sheet.
        data: what the JSON scripts hold, by id.
        unclosed: elements that were not ended.
    """

    def __init__(self, source: str) -> None:
        super().__init__(convert_charrefs=True)
        self.source = source
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.ids: list[str] = []
        self.text = ""
        self.scripts: list[str] = []
        self.data: dict[str, Any] = {}
        self.unclosed: list[str] = []
        self._inside: dict[str, str | None] | None = None
        self.feed(source)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        self.tags.append((tag, named))
        if named.get("id"):
            self.ids.append(str(named["id"]))
        if tag not in ("meta", "input"):
            self.unclosed.append(tag)
        self._inside = named if tag in ("script", "style") else None

    def handle_endtag(self, tag: str) -> None:
        assert self.unclosed.pop() == tag
        self._inside = None

    def handle_data(self, data: str) -> None:
        if self._inside is None:
            self.text += data
        elif self._inside.get("type") == "application/json":
            self.data[str(self._inside["id"])] = json.loads(data)
        else:
            self.scripts.append(data)

    def of(self, tag: str) -> list[dict[str, str | None]]:
        """Return the attributes of all elements of a kind."""
        return [attributes for name, attributes in self.tags if name == tag]


def report_data_of(path: Path) -> ReportData:
    """Read a capture."""
    builder = ReportDataBuilder()
    with open_capture(str(path)) as file:
        run_pipeline(PacketDecoder(frozenset({5007})).decode(file), builder.diagnosis, builder)
    data = builder.report_data()
    assert data is not None
    return data


@cache
def page_of(name: str) -> Page:
    """Make a report of one of the samples, and read it."""
    return Page(report_page(report_data_of(CAPTURES / name), [name], "1.2.3"))
