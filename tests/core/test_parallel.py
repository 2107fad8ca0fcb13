"""Chunks for threads and ranks, and arrays that ranks have in common; tests/cli/test_mpi.py does the same with MPI."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from grids import frame
from pretended import UNTOUCHED, rank

from meshdeform_core.grid import Grid
from meshdeform_core.parallel import (
    OneRank,
    Shared,
    alone,
    carried,
    current_ranks,
    empty,
    for_chunks,
    for_rows,
    set_threads,
    sharing,
    thread_count,
)
from meshdeform_core.parallel.mpi import _is_common, _mapped, _memory_file

needs_linux = pytest.mark.skipif(not hasattr(os, "memfd_create"), reason="shared memory requires Linux")


def chunks_of(number, count, **filled):
    found = []
    with rank(number, count, []):
        for_chunks(lambda lo, hi: found.append((lo, hi)), 10, 2, **filled)
    return sorted(found)


def test_a_process_alone_does_all_chunks():
    done = []
    for_chunks(lambda lo, hi: done.append((lo, hi)), 10, 4)
    assert sorted(done) == [(0, 4), (4, 8), (8, 10)]
    assert OneRank().on_first(lambda: 7) == 7
    assert OneRank().once(lambda: 8) == 8
    assert OneRank().gather([9]) == [9]


def test_what_all_need_is_dealt_out_and_the_rest_is_not():
    everything = [(0, 2), (2, 4), (4, 6), (6, 8), (8, 10)]
    for shared in ([], [Shared(np.empty(10))]):
        dealt = [chunks_of(number, 3, shared=shared) for number in range(3)]
        assert dealt == [[(0, 2), (6, 8)], [(2, 4), (8, 10)], [(4, 6)]]
    assert chunks_of(1, 3) == everything
    # The pretended ranks cannot fill an array together without sending: each does all of it.
    assert chunks_of(1, 3, common=[np.empty(10)]) == everything


def test_work_that_must_not_run_at_the_same_time_does_not():
    threads = set()
    set_threads(4)
    try:
        for_chunks(lambda lo, hi: threads.add(threading.get_ident()), 100, 1, threads=1)
    finally:
        set_threads(None)
    assert threads == {threading.get_ident()}


def test_rows_are_all_filled_once():
    counts = np.zeros((50_000, 2))
    for_rows(lambda rows: np.add(counts[rows], 1, out=counts[rows]), counts)
    assert (counts == 1).all()


def test_only_large_arrays_are_in_common():
    with rank(0, 2, arrays := [], small=1000):
        empty([249], np.int32)
        assert not arrays
        assert empty([250], np.int32) is arrays[0]
    assert arrays[0].dtype == np.int32
    assert not _is_common(empty((1 << 18, 3))[5:])


def test_what_the_first_rank_does_alone_meets_nobody():
    with rank(0, 3, arrays := []):
        with alone():
            assert (current_ranks().count, current_ranks().cores) == (1, 1)
            empty([3])
        assert current_ranks().count == 3
    assert not arrays


def test_grids_are_filled_by_all_ranks_together():
    whole, arrays = frame(), []
    for number in range(3):
        with rank(number, 3, arrays):
            grid = Grid.from_blocks([whole.block(b) for b in range(whole.n_blocks)])
        for block in range(grid.n_blocks):
            is_there = not (grid.block(block) == UNTOUCHED).any()
            assert is_there == (block % 3 <= number)
    np.testing.assert_array_equal(grid.points, whole.points)


def test_a_block_that_cannot_be_filled_ends_the_filling():
    grid, called = Grid.allocate([(2, 2, 2)] * 4), []

    def put(block):
        called.append(block)
        if block == 1:
            raise OSError("made to fail")

    with pytest.raises(OSError, match="made to fail"):
        grid.fill(put)
    assert called == [0, 1]


HOLDER = """
import sys, time
from meshdeform_core.parallel.mpi import _mapped, _memory_file
name = _memory_file(1000)
memory = _mapped(name, 1000)
memory[:5] = b"hello"
print(name, flush=True)
time.sleep(60)
"""


@needs_linux
def test_common_memory_outlives_the_process_that_made_it_and_leaves_nothing_behind():
    with subprocess.Popen([sys.executable, "-c", HOLDER], stdout=subprocess.PIPE, text=True) as holder:
        try:
            name = holder.stdout.readline().strip()
            assert os.readlink(name).startswith("/memfd:")
            memory = _mapped(name, 1000)
            memory[5:7] = b" !"
        finally:
            holder.send_signal(signal.SIGKILL)
    assert memory[:7] == b"hello !"
    assert not Path(name).exists()


@needs_linux
def test_views_of_common_memory_are_known():
    name = _memory_file(240)
    array = np.ndarray((10, 3), buffer=_mapped(name, 240))
    os.close(int(name.rpartition("/")[2]))
    assert _is_common(array)
    assert _is_common(array[2:].reshape(-1)[::2])
    assert not _is_common(array + 1)


@needs_linux
def test_memory_that_cannot_be_found_is_an_error():
    with pytest.raises(OSError, match="No such file"):
        _mapped("/proc/self/fd/999999", 100)


@pytest.mark.parametrize("threads", [1, 3])
def test_progress_ends_with_all_items_and_comes_from_the_thread_that_asked(threads):
    told = []
    for_chunks(
        lambda lo, hi: time.sleep(1e-3),
        100,
        7,
        lambda done, size: told.append((done, size, threading.get_ident())),
        threads=threads,
    )
    counts = [done for done, _, _ in told]
    assert counts == sorted(counts)
    assert told[-1] == (100, 100, threading.get_ident())
    assert {(size, thread) for _, size, thread in told} == {(100, threading.get_ident())}


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_ends_the_loop_when_no_chunk_runs_any_more(threads):
    begun, ended = [], []

    def work(lo, hi):
        begun.append(lo)
        if lo == 5:
            raise ValueError("chunk 5")
        time.sleep(1e-2)
        ended.append(lo)

    with pytest.raises(ValueError, match="chunk 5"):
        for_chunks(work, 1000, 1, threads=threads)
    assert len(begun) < 20
    assert sorted(begun) == sorted([*ended, 5])


def test_an_interrupt_from_the_progress_ends_the_loop():
    done = []

    def work(lo, hi):
        time.sleep(1e-3)
        done.append(lo)

    def stop(*_):
        raise SystemExit(130)

    with pytest.raises(SystemExit):
        for_chunks(work, 10_000, 1, stop, threads=2)
    count = len(done)
    time.sleep(0.05)
    assert len(done) == count < 100


def test_threads_of_a_program_do_not_change_each_others_setting():
    set_threads(3)
    found, inside, leave = {}, threading.Event(), threading.Event()

    def other() -> None:
        with sharing(OneRank(1), 1):
            inside.set()
            assert leave.wait(10)
            found["other"] = thread_count()

    thread = threading.Thread(target=other)
    thread.start()
    try:
        assert inside.wait(10)
        found["this"] = sharing_of_this()
        with alone():
            found["alone"] = sharing_of_this()
    finally:
        leave.set()
        thread.join()
        set_threads(None)
    assert found == {"this": 3, "alone": 3, "other": 1}


def sharing_of_this() -> int | None:
    """The number of threads asked for, whatever this machine has; a thread for whom it is carried sees the same."""
    from meshdeform_core.parallel.loops import _sharing

    here = _sharing.get().threads
    seen: list[int | None] = []
    thread = threading.Thread(target=carried(lambda: seen.append(_sharing.get().threads)))
    thread.start()
    thread.join()
    assert seen == [here]
    return here
