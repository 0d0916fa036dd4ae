"""Executes a notebook in this environment, and fails where a cell does, or one that should show something
does not.
"""

import sys

import nbformat
from nbclient import NotebookClient

notebook = nbformat.read(sys.argv[1], as_version=4)
NotebookClient(notebook, timeout=1200, kernel_name="python3").execute()
outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
kinds = {kind for output in outputs for kind in output.get("data", {})}
missing = {"image/png", "text/html"} - kinds
if missing:
    sys.exit(f"{sys.argv[1]} shows nothing of the kind {', '.join(sorted(missing))}")
print(f"{sys.argv[1]}: {len(notebook.cells)} cells ran; {len(outputs)} outputs, of them pictures and a page")
