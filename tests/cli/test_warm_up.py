"""Compiling: told once, timed apart, done ahead, or done without a cache."""

import json
import os
import subprocess
import sys

import pytest

from meshdeform_core import setup
from meshdeform_core.numerics import jit


def _started(*command, cache):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    return subprocess.run([sys.executable, *command], env=environment, capture_output=True, text=True)


@pytest.mark.slow
def test_the_first_run_says_that_it_compiles_and_counts_it_apart(bench, tmp_path):
    command = ["-m", "meshdeform_cli", "deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz", "--force"]
    command += ["-m", "idw-tfi"]
    runs = [_started(*command, "--report", "out.json", cache=tmp_path / "loops") for _ in range(2)]
    assert [run.returncode for run in runs] == [0, 0]
    assert runs[0].stderr.count("compiling loops, once per installation") == 1
    assert "compiling" not in runs[1].stderr
    first = json.loads((bench / "out.json").read_text())["timing"]
    assert "compile" not in first  # of the second run
    # One signature each: plain numbers, slices with steps and read-only arrays would each have a loop compiled again.
    loops = [path.name for path in (tmp_path / "loops").rglob("*.nbc")]
    assert len(loops) > 10
    assert [name for name in loops if not name.endswith(".1.nbc")] == []


def test_compiling_is_a_stage_of_its_own(monkeypatch):
    seconds = iter([10.0, 10.0])
    monkeypatch.setattr(setup, "compile_seconds", lambda: next(seconds))
    timing = setup.Timing()
    with timing.stage("apply"):
        pass
    assert list(timing.seconds) == ["apply"]
    now, spent = iter([0.0, 7.0]), iter([1.0, 5.0])
    monkeypatch.setattr(setup.clock, "perf_counter", lambda: next(now))
    monkeypatch.setattr(setup, "compile_seconds", lambda: next(spent))
    with timing.stage("prepare"):
        pass
    assert timing.seconds["prepare"] == 3.0
    assert timing.seconds["compile"] == 4.0


def test_without_a_folder_for_the_cache_loops_are_compiled_all_the_same(monkeypatch):
    def refuse(self):
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr("numba.core.dispatcher.Dispatcher.enable_caching", refuse)
    monkeypatch.setattr(jit._clock, "cached", True)
    before, heard = jit.compiled_loops(), []
    monkeypatch.setattr(jit._clock, "notice", heard.append)

    @jit.kernel
    def twice(x):
        return 2 * x

    assert not jit.is_cached()
    assert twice(3) == 6
    assert jit.compiled_loops() == before + 1
    assert heard == [before]
