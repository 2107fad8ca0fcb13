"""Compiling: told once, timed apart, done ahead, or done without a cache."""

import importlib
import json
import os
import re
import subprocess
import sys
from functools import partial

import pytest

from meshdeform_cli import warm_up_runs
from meshdeform_core import setup
from meshdeform_core.numerics import jit


def _started(*command, cache):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    return subprocess.run([sys.executable, *command], env=environment, capture_output=True, text=True)


@pytest.mark.slow
def test_the_first_run_says_that_it_compiles_and_counts_it_apart(bench, tmp_path):
    command = ["-m", "meshdeform_cli", "deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz", "--force"]
    command += ["-m", "tfi", "--steps", "1", "--repair", "off"]
    runs = [_started(*command, "--report", "out.json", cache=tmp_path / "loops") for _ in range(2)]
    assert [run.returncode for run in runs] == [0, 0]
    assert runs[0].stderr.count("compiling loops, once per installation") == 1
    assert "compiling" not in runs[1].stderr
    first = json.loads((bench / "out.json").read_text())["timing"]
    assert "compile" not in first  # of the second run
    assert len(list((tmp_path / "loops").rglob("*.nbc"))) > 10


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
    def refuse(function):
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(jit, "_Cache", refuse)
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
        before = jit.compiled_loops()
        if not writable and home == "new_boxes":
            monkeypatch.setattr(jit._Cache, "flush", _refuse)
        assert loops.width(boxes.Box(1.0, 3.0)) == 2.0
        compiled.append(jit.compiled_loops() - before)
        (tmp_path / f"{home}.py").unlink()
        for name in (home, "loops_of_boxes"):
            del sys.modules[name]
    assert compiled == [1, 1, 0 if writable else 1]


def test_a_cache_that_cannot_be_written_does_not_matter(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(jit._clock, "cached", True)
    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.save", _refuse)
    (tmp_path / "loops_on_full_disks.py").write_text(LOOP + "@kernel\ndef half(x):\n    return 0.5 * x\n")
    assert importlib.import_module("loops_on_full_disks").half(3.0) == 1.5
    assert not jit.is_cached()


def _refuse(*_):
    raise OSError(28, "No space left on device")


@pytest.mark.slow
def test_loops_that_other_processes_compile_are_counted(call, monkeypatch):
    run = partial(exec, "from numba import njit; njit(lambda x: x)(1.0)")
    monkeypatch.setattr(warm_up_runs, "runs", lambda: iter([run] * 3))
    told = call("warm-up").out
    assert re.fullmatch(r"3 loops compiled, the others were already compiled; [\d.]+ s\n", told), told


def test_a_process_that_dies_while_it_compiles_is_told(call, monkeypatch):
    monkeypatch.setattr(warm_up_runs, "runs", lambda: iter([partial(os._exit, 1)]))
    done = call("warm-up")
    assert (done.code, done.out, "was killed" in done.err) == (2, "", True)


def test_quietly_it_prints_nothing(call, monkeypatch):
    monkeypatch.setattr(warm_up_runs, "run_everything", lambda _: 3)
    assert call("warm-up").out.startswith("3 loops compiled")
    assert call("warm-up", "-q").out == ""
