"""ARCHITECTURE.md names what exists, and all state of the process; functions beside kernels are typed."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
PACKAGES = ("meshdeform", "cli", "sample_cases", "formats", "meshdeform_core")
SHARED = r"(\w+\.)*(Lock|RLock|local|ContextVar|lru_cache|cache)\b"
STATE = re.compile(rf"^(@|\w+(: .+)? = ){SHARED}|^_[a-z][a-z_]*(: .+)? = [\[{{]|^ +global ", re.MULTILINE)
"""Locks, context variables, caches, private lists and objects that change, at the top of a module; names that functions
set there."""


def test_the_files_that_it_names_exist():
    named = re.findall(r"`([a-z_/]+\.(?:py|md|toml)|[a-z_/]+/)`", TEXT)
    assert len(named) > 40
    folders = (ROOT, *(ROOT / package for package in PACKAGES), ROOT / "meshdeform_core" / "numerics")
    places = [*folders, *(path.parent for package in PACKAGES for path in (ROOT / package).rglob("__init__.py"))]
    assert [name for name in named if not any((place / name).exists() for place in places)] == []


def test_it_describes_every_module_and_package_of_the_core():
    core = ROOT / "meshdeform_core"
    names = [f"{path.parent.name}/" for path in core.glob("*/__init__.py")]
    names += [path.name for path in core.glob("*.py") if path.name != "__init__.py"]
    assert [name for name in names if f"`{name}`" not in TEXT] == []


def test_it_lists_the_state_of_the_process():
    state = TEXT[TEXT.index("| state | reason |") :]
    every = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    files = [path for path in every if STATE.search(path.read_text(encoding="utf-8"))]
    assert len(files) > 5
    names = {
        path: str(path.relative_to(ROOT)).removeprefix("meshdeform_core/").removeprefix("numerics/") for path in files
    }
    assert [name for name in names.values() if name not in state] == []


KERNELS = {"kernel", "fast_kernel", "contracted_kernel", "inlined", "intrinsic", "overload"}
FILES = sorted(
    [*(ROOT / "meshdeform_core" / "numerics").rglob("*.py"), *(ROOT / "meshdeform_core" / "repair").rglob("*.py")]
)


def plain_functions(tree):
    """Functions that Python runs: neither kernels nor what is within them, nor what only stands for an overload."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef):
            names = {ast.unparse(decorator).split("(")[0].split(".")[-1] for decorator in node.decorator_list}
            if names & KERNELS or ast.unparse(node.body[-1]) == "raise NotImplementedError":
                continue
            yield node
        yield from plain_functions(node)


def test_functions_beside_kernels_are_typed():
    found = [(path.name, each) for path in FILES for each in plain_functions(ast.parse(path.read_text("utf-8")))]
    assert len(found) > 100
    for file, function in found:
        arguments = function.args
        every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
        untyped = [a.arg for a in every if a.annotation is None and a.arg not in ("self", "cls")]
        assert function.returns is not None or function.name == "__init__", f"{file}: {function.name} has no type"
        assert not untyped, f"{file}: {function.name} takes {untyped} without types"
