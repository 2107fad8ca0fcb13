"""Chunks of loops for the threads of a process."""

import threading
import time

import pytest

from meshdeform_core.parallel import current_sharing, for_chunks, set_sharing, sharing, thread_count


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


def test_threads_of_a_program_do_not_change_each_others_setting():
    set_sharing(threads=3)
    found, inside, leave = {}, threading.Event(), threading.Event()

    def other() -> None:
        with sharing(threads=1):
            inside.set()
            assert leave.wait(10)
            found["other"] = thread_count()

    thread = threading.Thread(target=other)
    thread.start()
    try:
        assert inside.wait(10)
        found["this"] = current_sharing().threads
        with sharing(apart=True):
            found["apart"] = current_sharing().threads
    finally:
        leave.set()
        thread.join()
        set_sharing(threads=None)
    assert found == {"this": 3, "apart": 3, "other": 1}
