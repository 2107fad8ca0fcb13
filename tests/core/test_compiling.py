"""Loops are compiled in several processes, found wherever they lie, and compiled again when their sources change."""

import importlib
import os
import subprocess
import sys
import textwrap
import threading

import pytest

from meshdeform_core.errors import CaseError
from meshdeform_core.numerics import jit, processor
from meshdeform_core.numerics.exact.radial import radial_block
from meshdeform_core.numerics.fastsum.radial import sum_regions

LOOPS = """
from typing import NamedTuple
from meshdeform_core.numerics.jit import kernel, record

@record("f8[::1], f8")
class Line(NamedTuple):
    points: object
    weight: float

""" + "\n".join(
    f"""
@kernel("f8[::1], Line", Line)
def loop_{number}(out, line):
    {"pass" if number == 0 else f"loop_{number - 1}(out, line)"}
    for n in range(out.size):
        out[n] {"= line.weight * line.points[n]" if number == 0 else "+= 1.0"}
"""
    for number in range(3)
)

CALLS = """
import os, sys
import numpy as np
import many_loops
from meshdeform_core.numerics import jit
told = []
jit.compile_clock.notice = told.append
line = many_loops.Line(np.arange(3.0), 2.0)
out = np.empty(3)
for number in range(3):
    getattr(many_loops, f"loop_{number}")(out, line)
    assert out.tolist() == [number, number + 2, number + 4]
print(jit.compile_clock.loops, *(max((note[part] for note in told), default=0) for part in (1, 2)))
"""


def run(folder, code, **environment):
    """Lines printed by a fresh interpreter."""
    (folder / "many_loops.py").write_text(LOOPS)
    known = os.environ | {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "loops")} | environment
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], env=known, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.timeout(240)
def test_several_processes_compile_what_is_missing_and_later_runs_find_it(tmp_path):
    two_cores = "from meshdeform_core.parallel import loops; loops.usable_cores = lambda: 2\n"
    own, expected, processes = map(int, run(tmp_path, two_cores + CALLS))
    assert own <= expected == 3
    assert processes == 2
    # As in an installation by another user: no folder of this user's can be written either.
    sealed = """
from numba.core import caching
def refuse(self):
    raise OSError("read-only")
caching._CacheLocator.ensure_cache_path = refuse
"""
    assert run(tmp_path, sealed + CALLS) == ["0", "0", "0"]


def test_all_loops_are_compiled_once_each(monkeypatch):
    monkeypatch.setattr(jit, "usable_cores", lambda: 1)
    compiled, missing = [], list("abcdefgh")
    compilers = jit.Compilers(
        lambda: [name for name in missing if name not in compiled], compiled.append, lambda one, other: False
    )
    compilers.obtain("c")
    compiled.append("c")
    assert compilers.all() == 7
    assert sorted(compiled) == missing


def test_what_calls_a_loop_that_is_waited_for_is_not_compiled_meanwhile(monkeypatch):
    monkeypatch.setattr(jit, "usable_cores", lambda: 1)
    compiled = list[str]()
    compilers = jit.Compilers(lambda: list("abcde"), compiled.append, lambda one, other: one in "bd" and other == "a")
    compilers.begin("c")
    elsewhere = compilers._take()
    assert elsewhere == "a"
    timer = threading.Timer(0.2, compilers._finish, ["a"])
    timer.start()
    assert compilers.obtain("a") == 2
    assert sorted(compiled) == ["c", "e"]
    timer.join()


def test_loops_that_call_others_are_told():
    outer, inner = (f"{loop.py_func.__module__}.{loop.__name__}:0" for loop in (sum_regions, radial_block))
    assert jit.loop_calls(outer, inner)
    assert not jit.loop_calls(inner, outer)


def test_a_loop_is_compiled_anew_when_a_function_of_another_file_changes(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    # Bytecode of Python itself is told apart by whole seconds.
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    (tmp_path / "outer_loop.py").write_text(
        "from inner_loop import FACTOR, add\nfrom meshdeform_core.numerics.jit import kernel\n"
        "@kernel\ndef twice(x):\n    return FACTOR * add(x)\n"
    )
    digests = []
    for factor, added in ((2, 0), (2, 1), (3, 1), (3, 1)):
        (tmp_path / "inner_loop.py").write_text(
            f"from meshdeform_core.numerics.jit import inlined\nFACTOR = {factor}\n"
            f"@inlined\ndef add(x):\n    return x + {added}\n"
        )
        importlib.invalidate_caches()
        loop = importlib.import_module("outer_loop").twice
        assert loop(1.0) == factor * (1 + added)
        digests.append(jit.source_of(loop.py_func)[0])
        for name in ("inner_loop", "outer_loop"):
            del sys.modules[name]
    assert len(set(digests)) == 3
    assert digests[2] == digests[3]


@pytest.mark.parametrize(
    ("level", "problem"), [("x86-64-v3", "lacks avx2"), ("x86-64-v9", "expected one of x86-64, x86-64-v2")]
)
def test_a_level_that_is_unknown_or_above_this_processor_is_refused(monkeypatch, level, problem):
    monkeypatch.setenv("MESHDEFORM_CPU", level)
    monkeypatch.setattr("llvmlite.binding.get_host_cpu_features", lambda: {"sse2": True, "avx2": False})
    with pytest.raises(CaseError, match=problem):
        processor.choose_processor()
    # Once numba is there it compiles for the level that it was imported with.
    monkeypatch.setenv("MESHDEFORM_CPU", "x86-64")
    with pytest.raises(CaseError, match="numba was imported before meshdeform"):
        processor.choose_processor()
    monkeypatch.setenv("NUMBA_CPU_NAME", "x86-64")
    processor.choose_processor()


RUNS = """
from cases import body_specs, turning
from grids import frame, frame_2d
from meshdeform_core.deform import Case, deform
from meshdeform_core.methods import Options

body, span = body_specs(turning("20"))
for grid, walls in ((frame_2d(), (body,)), (frame(), (body, span))):
    assert deform(grid, Case(walls, method=Options("tfi"))).valid
"""


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_loops_of_tfi_and_of_the_verdict_stay_within_their_arrays(tmp_path):
    """In a process and a cache of its own: checks are compiled into the loops."""
    own = {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-P", "-c", RUNS], env=os.environ | own, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
