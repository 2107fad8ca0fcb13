"""Chunks of loops for the threads of a process; results do not depend on how much is done at a time."""

import importlib
import pkgutil
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from cases import body_specs, turning
from grids import frame, with_walls

import meshdeform_core
from meshdeform_core.deform import Case, set_up
from meshdeform_core.grid.connections import find_interfaces
from meshdeform_core.grid.faces import find_outside
from meshdeform_core.grid.openings import find_openings
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.methods import IDW, RBF, Options
from meshdeform_core.numerics.geometry import coincidence
from meshdeform_core.parallel import current_sharing, for_chunks, set_sharing, sharing, thread_count
from meshdeform_core.parallel.loops import usable_cores
from meshdeform_core.quality.shape import shape_measures
from meshdeform_core.series import Schedule, deform_series


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_ends_the_loop_when_no_chunk_runs_any_more(threads):
    begun, ended, told, later = [], [], [], threading.Event()

    def work(lo, hi):
        begun.append(lo)
        # Chunk 6 fails before chunk 5, if another thread has begun it; the error is that of the first chunk.
        if (later.set() if lo == 6 else lo == 5 and later.wait(0.1)) or lo in (5, 6):
            raise ValueError(f"chunk {lo}")
        time.sleep(1e-2)
        ended.append(lo)

    with pytest.raises(ValueError, match="chunk 5"):
        for_chunks(work, 1000, 1, threads=threads)
    assert len(begun) < 500
    assert sorted(begun) == sorted([*ended, *({5, 6} & set(begun))])
    for_chunks(lambda *_: time.sleep(1e-2), 10, 4, lambda *each: told.append(each), threads)
    assert (told, told[-1]) == (sorted(told), (10, 10))


def test_threads_of_a_program_do_not_change_each_others_setting():
    set_sharing(threads=3)
    try:
        with sharing(threads=1), ThreadPoolExecutor(1) as pool:
            assert thread_count() == 1
            assert pool.submit(current_sharing).result().threads is None
        with sharing(apart=True):
            assert current_sharing().threads == 3
        with sharing(threads=10**6):
            assert thread_count() == usable_cores()
    finally:
        set_sharing(threads=None)


BATCHES = "_TOGETHER _QUADS _STRETCH _MAPPED _MATCHED _WINDOW _ROWS _FACES _CHUNK _TARGETS _MANY"


def outcome(options):
    """What a series with a repair gives, on curved slip faces, and what is found in its grid."""
    grid = with_walls(frame(4, 3))
    x = grid.points.copy()
    x[:, 2] += 0.15 * np.sin(1.1 * x[:, 0]) * np.cos(0.8 * x[:, 1])
    grid = grid.moved(x)
    setup = set_up(grid, Case(tuple(body_specs(turning("25*t"))), method=options, open_faces=True))
    found = [
        (level.result.grid.points.tobytes(), level.velocity.tobytes(), level.result.assessment, level.result.warnings)
        for level in deform_series(setup, Schedule((1.0, 2.0), velocity="first"), "float64")
    ]
    where, outside, opened = setup.undeformed, find_outside(grid, setup.topology), grid.points.copy()
    grid.block(1, opened)[:, -1, 1:, 1] += 0.01
    found.append([(str(face), role) for face, role in zip(outside.faces, outside.roles, strict=True)])
    found.append([str(each) for each in find_openings(grid.moved(opened), find_topology(grid.moved(opened)))])
    found.append([find_interfaces(grid, setup.topology), str(shape_measures(grid))])
    found.append(where.crossings(setup.displacement(1.0).any(axis=1, keepdims=True) * [1.7, 0.2, 0.0]))
    assert all(map(len, found))
    at = setup.displacement(1.0)[where.source_numbers]
    derivative = where.prepare(options).linearised(at)
    found.append(derivative.push(at[::-1].copy()).tobytes())
    return found, derivative.pull(np.cos(grid.points))


METHODS = Options("idw-tfi", idw=IDW(summation="fast")), Options("rbf-tfi", rbf=RBF(summation="fast"))


@pytest.mark.parametrize("options", METHODS, ids=lambda each: each.name)
def test_small_batches(options, monkeypatch):
    expected, gradient = outcome(options)
    found = pkgutil.walk_packages(meshdeform_core.__path__, "meshdeform_core.")
    modules = [importlib.import_module(module.name) for module in found]
    sizes = [(m, name) for m in modules for name in BATCHES.split() if getattr(m, name, 0) >= 1000]
    assert len(sizes) > 35
    # Many different rows have the same key, too.
    for *each, value in [*((*each, 37) for each in sizes), (coincidence, "mixed", lambda rows: rows.sum(axis=1) % 37)]:
        monkeypatch.setattr(*each, value)
    found, other = outcome(options)
    for one, two in zip(found, expected, strict=True):
        assert one == two
    np.testing.assert_allclose(other, gradient, rtol=0, atol=1e-10 * np.abs(gradient).max())
