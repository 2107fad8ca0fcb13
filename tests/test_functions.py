"""Functions and files are short and folders small; ruff limits branches and parameters."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
FILES = [
    path
    for folder in ("meshdeform", "cli", "formats", "sample_cases", "meshdeform_core")
    for path in (ROOT / folder).rglob("*.py")
]
LONGEST_FUNCTION, NINE_IN_TEN, LONGEST_FILE, LARGEST_FOLDER = 45, 18, 350, 17


def lines_of_functions(path: Path) -> Iterator[tuple[str, int]]:
    """Name and number of lines, docstring aside, of each function in a file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef) and node.end_lineno is not None:
            first = node.body[0]
            docstring = (first.end_lineno or 0) - first.lineno + 1 if ast.get_docstring(node) is not None else 0
            yield f"{path.relative_to(ROOT)}: {node.name}", node.end_lineno - node.lineno + 1 - docstring


def test_functions_are_short():
    found = [each for path in FILES for each in lines_of_functions(path)]
    assert len(found) > 3000
    assert [each for each in found if each[1] > LONGEST_FUNCTION] == []
    assert sorted(count for _, count in found)[len(found) * 9 // 10] <= NINE_IN_TEN


def test_files_are_short_and_folders_small():
    lines = {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8").count("\n") for path in FILES}
    assert {name: count for name, count in lines.items() if count > LONGEST_FILE} == {}
    folders = Counter(str(path.parent.relative_to(ROOT)) for path in FILES)
    assert {name: count for name, count in folders.items() if count > LARGEST_FOLDER} == {}
