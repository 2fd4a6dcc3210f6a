"""Read tables: text files with one row per line and tabs between the columns."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import zip_longest


def table_rows(name: str, folder: str = os.path.dirname(__file__)) -> Iterator[dict[str, str]]:
    """Yield each row of a table as a dictionary from column name to cell. A blank cell is "". Lines that
    begin with ``#`` are comments; the first other line names the columns.
    """
    with open(os.path.join(folder, f"{name}.tsv"), encoding="utf-8") as table:
        header, *rows = (line.rstrip("\n").split("\t") for line in table if not line.startswith("#"))
    return (dict(zip_longest(header, row, fillvalue="")) for row in rows)
