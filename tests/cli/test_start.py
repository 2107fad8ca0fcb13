"""The start of a command: what it imports; compiling is told once, timed apart, done ahead, or without a cache."""

import importlib
import os
import re
import subprocess
import sys

import pytest
from grids import frame, with_walls

from meshdeform_cli import process
from meshdeform_core import setup
from meshdeform_core.numerics import jit
from meshdeform_formats import write_grid

HEAVY = ("numba", "scipy", "vtk", "vtkmodules", "matplotlib", "meshio", "rich")
CODE = """
import sys
from meshdeform_cli.main import run
codes = [run(words.split()) for words in sys.argv[1:]]
print(codes, sorted(set(name.partition(".")[0] for name in sys.modules) & set({heavy!r})), "numpy" in sys.modules)
"""


def imported(*commands: str) -> str:
    """Exit codes, heavy modules, and whether numpy was imported, after commands in a fresh interpreter."""
    done = subprocess.run(
        [sys.executable, "-c", CODE.format(heavy=HEAVY), *commands], capture_output=True, text=True, timeout=60
    )
    return done.stdout.splitlines()[-1]


def test_help_imports_nothing_heavy_and_info_neither_numba_nor_scipy(tmp_path, monkeypatch):
    assert imported("--help", "deform --help", "series --help") == "[0, 0, 0] [] False"
    monkeypatch.chdir(tmp_path)
    for name in ("grid.cgns", "grid.xyz"):
        write_grid(with_walls(frame()), name)
    assert imported("info grid.cgns", "info grid.xyz") == "[0, 0] [] True"


LAZY = """
import os, sys
from meshdeform_cli.main import run
class Watch:
    def find_spec(self, name, path=None, target=None):
        if name == "numpy":
            print("threads", os.environ.get("OPENBLAS_NUM_THREADS"))
sys.meta_path.insert(0, Watch())
code = run(sys.argv[1:])
lazy = {
    "scipy.sparse", "scipy.spatial", "scipy.io", "matplotlib", "meshio",
    "meshdeform_core.repair.derivative", "meshdeform_core.numerics.fastsum.radial",
    "meshdeform_core.numerics.fastsum.weighted", "meshdeform_core.numerics.krylov",
    "meshdeform_formats.picture", "meshdeform_formats.vtk", "meshdeform_formats.report.page",
}
print(code, sorted(lazy & set(sys.modules)))
"""


def test_hybrid_loads_nothing_that_it_does_not_use_and_linear_algebra_has_one_thread_from_the_start(tmp_path, call):
    """What numba imports by itself, for products of matrices inside loops, is scipy.linalg. Libraries of linear algebra
    read their number of threads when numpy is imported, which a path among the options may do."""
    assert call("sample", "hemisphere", "-o", tmp_path, "--size", "8").code == 0
    job = ["deform", tmp_path / "grid.cgns", "-c", tmp_path / "case.toml", "-o", tmp_path / "new.cgns", "-m", "idw-tfi"]
    command = [sys.executable, "-c", LAZY, *map(str, job), "--time", "2.5e-4", "-q"]
    plain = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, env=plain)
    assert done.stdout == "threads 1\n0 []\n", done.stderr


def test_the_end_looks_for_no_cycles_in_what_was_imported():
    """It would take a third of the time of a small run."""
    look = "print(gc.get_freeze_count() > 1000)"
    code = (
        f"import atexit, gc; from meshdeform_cli.main import main; atexit.register(lambda: {look}); main(['--version'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.splitlines()[-1] == "True"


def _started(*command, cache):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    return subprocess.run([sys.executable, *command], env=environment, capture_output=True, text=True)


def test_compiling_is_told_once_with_what_it_takes_and_whether_the_next_start_compiles_again(monkeypatch, capsys):
    monkeypatch.setattr(jit, "SECONDS_PER_LOOP", 4.0)
    for cached, enabled in ((True, True), (False, True), (True, False)):
        monkeypatch.setattr(jit.compile_clock, "cached", cached)
        with process.ProgressBar(enabled) as bar:
            for done in (0, 2) if jit.compile_clock.notice else ():
                jit.compile_clock.notice(jit.Compiled(done, 3, 2))
            assert bar.current == (("compile", 2, 3) if enabled else None)
    often = "once per installation", "at every start: no folder for them can be written; NUMBA_CACHE_DIR may name one"
    told = [f"meshdeform: compiling 3 loops in 2 processes, about 6 s, {each}" for each in often]
    assert capsys.readouterr().err.splitlines() == told


def test_compiling_is_a_stage_of_its_own(monkeypatch):
    spent = iter([10.0, 10.0, 1.0, 5.0])
    monkeypatch.setattr(setup, "compile_clock", type("", (), {"seconds": property(lambda _: next(spent))})())
    timing = setup.Timing()
    with timing.stage("apply"):
        pass
    assert list(timing.seconds) == ["apply"]
    now = iter([0.0, 7.0])
    monkeypatch.setattr(setup.clock, "perf_counter", lambda: next(now))
    with timing.stage("prepare"):
        pass
    assert timing.seconds["prepare"] == 3.0
    assert timing.seconds["compile"] == 4.0


BOX = "from typing import NamedTuple\nclass Box(NamedTuple):\n    low: float\n    high: float\n"
LOOP = "from meshdeform_core.numerics.jit import kernel\n@kernel\ndef width(box):\n    return box.high - box.low\n"


@pytest.mark.parametrize("writable", [True, False])
def test_a_cached_loop_of_a_class_that_moved_is_compiled_again(writable, tmp_path, monkeypatch):
    """After an update in place: the file of the loop is the same, the class of its argument is elsewhere."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "loops_of_boxes.py").write_text(LOOP)
    compiled = []
    for home in ("old_boxes", "new_boxes", "new_boxes"):
        (tmp_path / f"{home}.py").write_text(BOX)
        importlib.invalidate_caches()
        boxes, loops = (importlib.import_module(name) for name in (home, "loops_of_boxes"))
        before = jit.compile_clock.loops
        if not writable and home == "new_boxes":
            monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.flush", _refuse)
        assert loops.width(boxes.Box(1.0, 3.0)) == 2.0
        compiled.append(jit.compile_clock.loops - before)
        (tmp_path / f"{home}.py").unlink()
        for name in (home, "loops_of_boxes"):
            del sys.modules[name]
    assert compiled == [1, 1, 0 if writable else 1]


def test_a_cache_that_cannot_be_written_does_not_matter(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(jit.compile_clock, "cached", True)
    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.save", _refuse)
    (tmp_path / "loops_on_full_disks.py").write_text(LOOP + "@kernel\ndef half(x):\n    return 0.5 * x\n")
    assert importlib.import_module("loops_on_full_disks").half(3.0) == 1.5
    assert not jit.compile_clock.cached


def _refuse(*_):
    raise OSError(28, "No space left on device")


def test_it_counts_what_was_missing(call, monkeypatch):
    monkeypatch.setattr(jit, "compile_all", lambda: 3)
    assert re.fullmatch(r"3 loops compiled, the others were already compiled; [\d.]+ s\n", call("warm-up").out)
    assert call("warm-up", "-q").out == ""


def test_an_unknown_processor_is_refused_before_anything_is_compiled(tmp_path):
    done = _started("-m", "meshdeform_cli", "warm-up", "--cpu", "x86-64-v9", cache=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert "MESHDEFORM_CPU (or --cpu) is 'x86-64-v9'; expected one of x86-64, x86-64-v2" in done.stderr
