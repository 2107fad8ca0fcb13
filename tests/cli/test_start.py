"""What commands import: the start of a command line tool is mostly imports."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("numba", "scipy", "vtk", "vtkmodules", "matplotlib", "meshio", "rich")
CODE = """
import sys
from meshdeform_cli.main import run
code = run(sys.argv[1:])
print(code, sorted(set(name.partition(".")[0] for name in sys.modules) & set({heavy!r})), "numpy" in sys.modules)
"""


def imported(*arguments: object) -> str:
    """Exit code, heavy modules, and whether numpy was imported, after a command in a fresh interpreter."""
    command = [sys.executable, "-c", CODE.format(heavy=HEAVY), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    return done.stdout.splitlines()[-1]


@pytest.mark.parametrize("arguments", [["--help"], ["deform", "--help"], ["series", "--help"]])
def test_help_imports_nothing_heavy(arguments):
    assert imported(*arguments) == "0 [] False"


@pytest.mark.parametrize("suffix", [".cgns", ".xyz"])
def test_info_needs_neither_numba_nor_scipy(suffix, tmp_path, call):
    assert call("sample", "splitter-plate", "-o", tmp_path, "--suffix", suffix).code == 0
    assert imported("info", tmp_path / f"grid{suffix}") == "0 [] True"


LAZY = """
import sys
from meshdeform_cli.main import run
code = run(sys.argv[1:])
lazy = {
    "scipy.sparse", "scipy.spatial", "scipy.io", "matplotlib", "meshio",
    "meshdeform_core.repair.derivative", "meshdeform_core.numerics.fastsum.radial",
    "meshdeform_core.numerics.fastsum.weighted", "meshdeform_core.numerics.systems.krylov",
    "meshdeform_formats.picture", "meshdeform_formats.vtk", "meshdeform_formats.report.page",
}
print(code, sorted(lazy & set(sys.modules)))
"""


def test_hybrid_loads_nothing_that_it_does_not_use(tmp_path, call):
    """What numba imports by itself, for products of matrices inside loops, is scipy.linalg."""
    assert call("sample", "hemisphere", "-o", tmp_path, "--size", "8").code == 0
    job = ["deform", tmp_path / "grid.cgns", "-c", tmp_path / "case.toml", "-o", tmp_path / "new.cgns", "-m", "idw-tfi"]
    command = [sys.executable, "-c", LAZY, *map(str, job), "--time", "2.5e-4", "-q"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.stdout.splitlines()[-1] == "0 []", done.stderr


def test_the_end_looks_for_no_cycles_in_what_was_imported():
    """It would take a third of the time of a small run."""
    look = "print(gc.get_freeze_count() > 1000)"
    code = (
        f"import atexit, gc; from meshdeform_cli.main import main; atexit.register(lambda: {look}); main(['--version'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.splitlines()[-1] == "True"
