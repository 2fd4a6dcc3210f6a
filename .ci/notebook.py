"""Execute the notebook in Jupyter: .venv/bin/python .ci/notebook.py [--write].

Needs nbclient, ipykernel and matplotlib. ``--write`` stores the outputs in the notebook. Do this after you
change a cell.
"""

from __future__ import annotations

import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

NOTEBOOK = Path(__file__).parent.parent / "examples" / "joints.ipynb"


def main() -> None:
    """Run all cells; a cell that fails ends the program with its traceback."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    metadata = dict(notebook.metadata)
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(NOTEBOOK.parent)}}).execute()
    notebook.metadata.clear()
    notebook.metadata.update(metadata)  # without the version of Python
    for cell in notebook.cells:
        cell.metadata.clear()  # without times
    nbformat.validate(notebook)
    print(f"{NOTEBOOK.name}: {len(notebook.cells)} cells ran")
    if "--write" in sys.argv[1:]:
        nbformat.write(notebook, NOTEBOOK)


if __name__ == "__main__":
    main()
