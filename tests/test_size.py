"""The house does not grow: lines per package, lengths of functions and files. The budgets may only fall."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
PRODUCT = ("meshdeform", "cli", "formats", "sample_cases", "meshdeform_core")
BUDGETS = {
    "cli": 2588,
    "meshdeform": 2690,
    "sample_cases": 1461,
    "formats/case": 1290,
    "formats/cgns": 2124,
    "formats/displacement": 1035,
    "formats/openfoam": 1917,
    "formats/picture": 1228,
    "formats/plot3d": 894,
    "formats/report": 1017,
    "formats/series": 478,
    "formats/vtk": 1479,
    "formats": 1859,
    "meshdeform_core/boundary": 2965,
    "meshdeform_core/grid": 2583,
    "meshdeform_core/methods": 3803,
    "meshdeform_core/numerics": 8127,
    "meshdeform_core/parallel": 682,
    "meshdeform_core/quality": 1744,
    "meshdeform_core/repair": 2101,
    "meshdeform_core": 2454,
    "tests": 23981,
}
"""Lines of Python and of data files per package; a package's row excludes the rows below it."""
LONGEST_FUNCTION, NINE_IN_TEN, LONGEST_FILE = 60, 25, 500


def lines(path: Path) -> int:
    return path.read_text(encoding="utf-8").count("\n")


def files(folder: str) -> list[Path]:
    return sorted(path for path in (ROOT / folder).rglob("*.py") if "__pycache__" not in path.parts)


def functions(path: Path) -> Iterator[tuple[str, int]]:
    """Name and number of lines, docstring aside, of each function that numba does not compile."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef) and node.end_lineno is not None:
            decorators = " ".join(ast.unparse(each) for each in node.decorator_list)
            if "kernel" in decorators or "jit" in decorators:
                continue
            doc = node.body[0] if ast.get_docstring(node) is not None else None
            length = node.end_lineno - node.lineno + 1 - ((doc.end_lineno or 0) - doc.lineno + 1 if doc else 0)
            yield f"{path.relative_to(ROOT)}: {node.name}", length


def test_packages_keep_their_budgets():
    found = Counter[str]()
    for folder in (*PRODUCT, "tests"):
        for path in files(folder):
            place = path.relative_to(ROOT).parts
            two = "/".join(place[:2])
            found[two if two in BUDGETS else place[0]] += lines(path)
    assert found.keys() == BUDGETS.keys()
    # What tests expect stands in them, where its lines count; numba and Python keep what they have compiled there.
    assert {path.suffix for path in (ROOT / "tests").rglob("*.*") if path.is_file()} <= {".py", ".pyc", ".nbi", ".nbc"}
    assert {name: count for name, count in found.items() if count > BUDGETS[name]} == {}


def test_functions_and_files_can_be_read():
    found = [each for folder in PRODUCT for path in files(folder) for each in functions(path)]
    assert [each for each in found if each[1] > LONGEST_FUNCTION] == []
    assert sorted(length for _, length in found)[len(found) * 9 // 10] <= NINE_IN_TEN
    assert [str(path) for folder in PRODUCT for path in files(folder) if lines(path) > LONGEST_FILE] == []
