"""What mypy cannot be told: numba kernels need no types, everything beside them does."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
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


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_functions_beside_kernels_are_typed(path):
    for function in plain_functions(ast.parse(path.read_text(encoding="utf-8"))):
        arguments = function.args
        every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
        untyped = [a.arg for a in every if a.annotation is None and a.arg not in ("self", "cls")]
        assert function.returns is not None or function.name == "__init__", (
            f"{path.name}: {function.name} has no return type"
        )
        assert not untyped, f"{path.name}: {function.name} takes {untyped} without types"
