"""Writes `captures/` anew."""

from pathlib import Path

from tests.samples.catalogue import files

FOLDER = Path(__file__).parents[2] / "captures"

for name, data in files().items():
    (FOLDER / name).write_bytes(data)
