"""The size and shape of the code: the figures that CONTRIBUTING.md and tests/test_size.py hold it to.

    python studies/house.py             sizes, functions, names, private attributes, folders
    python studies/house.py --run       and what one ordinary deform loads and enters (splitter plate, CGNS)

A private function is one whose name begins with an underscore; it counts as used once if its file names it once
outside its definition. Accesses to private attributes count those of other objects than ``self`` and ``cls``.
"""

from __future__ import annotations

import ast
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parent.parent
PRODUCT = ("cli", "formats", "meshdeform", "meshdeform_core", "sample_cases")
OPEN = {"_replace", "_asdict", "_fields", "_exit"}
"""Attributes with an underscore that are public."""

RUN = """
import sys
entered, packages = set(), ("meshdeform",)
def profile(frame, event, _):
    if event == "call" and frame.f_globals.get("__name__", "").startswith(packages):
        entered.add(frame.f_code)
sys.setprofile(profile)
from meshdeform_cli.main import main
sys.argv = ["meshdeform", "deform", "case/grid.cgns", "-c", "case/case.toml", "-o", "out.cgns", "-q", "--force"]
try:
    main()
except SystemExit:
    pass
sys.setprofile(None)
# Without modules, comprehensions, and what dataclasses write.
names = [code for code in entered if not code.co_name.startswith("<") and code.co_filename != "<string>"]
loaded = [name for name in sys.modules if name.startswith(packages)]
print(f"one deform loads {len(loaded)} modules and enters {len(names)} functions")
"""


def tracked(*folders: str) -> list[Path]:
    listed = subprocess.run(["git", "ls-files", *folders], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [ROOT / name for name in listed.split("\n") if name and (ROOT / name).exists()]


def length(path: Path) -> int:
    return path.read_bytes().count(b"\n")


def inspect(paths: list[Path]) -> None:
    """Functions, names and accesses to private attributes in these files."""
    defined, lengths, once, foreign = Counter[str](), list[int](), 0, 0
    for path in paths:
        tree, used = ast.parse(path.read_text(encoding="utf-8")), Counter[str]()
        found = list[str]()
        for node in ast.walk(tree):
            if isinstance(node, ast.Name):
                used[node.id] += 1
            elif isinstance(node, ast.Attribute):
                used[node.attr] += 1
                private = node.attr.startswith("_") and not node.attr.startswith("__") and node.attr not in OPEN
                foreign += private and not (isinstance(node.value, ast.Name) and node.value.id in ("self", "cls"))
            elif isinstance(node, ast.FunctionDef):
                found.append(node.name)
                doc = ast.get_docstring(node, clean=False)
                lengths.append((node.end_lineno or 0) - node.lineno + 1 - (doc.count("\n") + 1 if doc else 0))
        defined.update(found)
        private_names = (name for name in found if name.startswith("_") and not name.startswith("__"))
        once += sum(used[name] == 1 for name in private_names)
    lengths.sort()
    total = len(lengths)
    print(f"functions {total}; 9 of 10 have at most {lengths[total * 9 // 10]} lines, the longest {lengths[-1]}")
    print(f"private functions used once in their file {once} ({100 * once / total:.1f} %)")
    print(f"accesses to other objects' private attributes {foreign}")
    print(f"names of functions defined three times or more {sum(count > 2 for count in defined.values())}")


def main(run: bool) -> None:
    code = [path for path in tracked(*PRODUCT) if path.suffix == ".py"]
    for folder in PRODUCT:
        own = [path for path in code if path.relative_to(ROOT).parts[0] == folder]
        print(f"{folder:16} {sum(map(length, own)):6} lines")
    folders = {path.parent for path in code}
    print(f"product          {sum(map(length, code)):6} lines in {len(code)} modules, {len(folders)} folders")
    print(f"tests            {sum(map(length, tracked('tests'))):6} lines")
    pages = [path for path in tracked("docs") if path.suffix == ".md"]
    print(f"docs             {sum(len(path.read_text(encoding='utf-8').split()) for path in pages):6} words")
    inspect(code)
    if run:
        with tempfile.TemporaryDirectory() as folder:
            program = str(Path(sys.executable).parent / "meshdeform")
            subprocess.run([program, "sample", "splitter-plate", "-o", "case"], cwd=folder, check=True)
            command = [sys.executable, "-c", RUN]
            for _ in range(2):  # The first run may compile.
                done = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
            print(done.stdout.strip().split("\n")[-1])


if __name__ == "__main__":
    main("--run" in sys.argv)
