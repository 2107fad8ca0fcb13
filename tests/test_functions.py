"""Functions stay short outside the loops that numba compiles; ruff limits their branches and parameters."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
LONGEST = 45


def lines_of_functions(path: Path) -> Iterator[tuple[str, int]]:
    """Name and number of lines, docstring aside, of each function in a file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef) and node.end_lineno is not None:
            first = node.body[0]
            docstring = (first.end_lineno or 0) - first.lineno + 1 if ast.get_docstring(node) is not None else 0
            yield f"{path.relative_to(ROOT)}: {node.name}", node.end_lineno - node.lineno + 1 - docstring


def test_functions_are_short():
    folders = ("meshdeform", "cli", "formats", "sample_cases", "meshdeform_core")
    files = [path for folder in folders for path in (ROOT / folder).rglob("*.py") if "numerics" not in path.parts]
    found = dict(each for path in files for each in lines_of_functions(path))
    assert len(found) > 2000
    assert {name: count for name, count in found.items() if count > LONGEST} == {}
