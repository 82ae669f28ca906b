"""Executes the notebooks: `python -m docs.build.notebooks [NAME ...]`, into `runs/notebooks/`,
where the site finds their outputs.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS, DONE = ROOT / "docs" / "notebooks", ROOT / "runs" / "notebooks"
LONGEST_S = 600  # of one cell


def execute(path: Path, out: Path) -> None:
    """Run a notebook in an empty folder, and write it with its outputs. CellExecutionError: one of
    its cells fails.
    """
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as empty:
        NotebookClient(
            notebook, timeout=LONGEST_S, resources={"metadata": {"path": empty}}
        ).execute()
    out.parent.mkdir(parents=True, exist_ok=True)
    nbformat.write(notebook, out)


def main() -> None:
    """Run those that are named, or all."""
    for name in sys.argv[1:] or sorted(path.stem for path in NOTEBOOKS.glob("*.ipynb")):
        execute(NOTEBOOKS / f"{name}.ipynb", DONE / f"{name}.ipynb")
        print(DONE / f"{name}.ipynb", flush=True)


if __name__ == "__main__":
    main()
