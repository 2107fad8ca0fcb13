"""Chunks of loops for the threads of a process."""

import threading
import time

import numpy as np
import pytest
from forked_ranks import on_ranks

from meshdeform_core.grid import Grid
from meshdeform_core.parallel import (
    Nodes,
    OneRank,
    agreed,
    alone,
    carried,
    current_ranks,
    for_chunks,
    set_threads,
    sharing,
    thread_count,
)


class Pretended(OneRank):
    """Rank ``number`` of ``count``; nothing is exchanged."""

    def __init__(self, number, count):
        super().__init__(cores=1)
        self.number, self.count, self.on_machine = number, count, count


def test_a_process_alone_does_all_chunks():
    done = []
    for_chunks(lambda lo, hi: done.append((lo, hi)), 10, 4)
    assert sorted(done) == [(0, 4), (4, 8), (8, 10)]
    assert OneRank().on_first(lambda: 7) == 7
    assert OneRank().gather([9]) == [9]


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
    Nodes.of(counts).each(lambda rows: np.add(counts[rows], 1, out=counts[rows]))
    assert (counts == 1).all()


def test_what_the_first_rank_does_alone_meets_nobody():
    with sharing(Pretended(0, 3), None):
        with alone():
            assert (current_ranks().count, current_ranks().cores) == (1, 1)
        assert current_ranks().count == 3


def test_a_block_that_cannot_be_filled_ends_the_filling():
    grid, called = Grid.allocate([(2, 2, 2)] * 4), []

    def put(block):
        called.append(block)
        if block == 1:
            raise OSError("made to fail")

    with pytest.raises(OSError, match="made to fail"):
        grid.fill(put)
    assert called == [0, 1]


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
    assert len(begun) < 500
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
    assert len(done) == count < 5000


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


def test_ranks_agree_on_the_largest_value():
    assert on_ranks(3, lambda number: agreed(current_ranks(), float(-number))) == [0.0, 0.0, 0.0]
    assert np.isnan(on_ranks(2, lambda number: agreed(current_ranks(), [1.0, np.nan][number]))).all()
    assert agreed(OneRank(), 2.5) == 2.5
