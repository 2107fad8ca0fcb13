"""Memory that is used again: never while anything still refers to it, never more than allowed."""

import gc
import pickle
import threading

import numpy as np
import pytest

from meshdeform_core.parallel import allow, empty, reuse, reusing_memory, uninitialised

N = 1 << 18


@pytest.fixture
def reused():
    with reusing_memory():
        allow(4 * 8 * N)
        yield


def test_memory_is_used_again_when_the_last_view_is_gone(reused):
    array = uninitialised((N, 3), "float64")[: N // 2]
    view = array[10:, 1]
    place = array.ctypes.data
    del array
    gc.collect()
    other = uninitialised((N, 3), "float64")
    assert not np.shares_memory(view, other)
    del view
    assert uninitialised((N, 3), np.float64).ctypes.data == place


def test_arrays_in_use_keep_their_values(reused):
    rng = np.random.default_rng(0)
    alive: list[tuple[np.ndarray, float]] = []
    again = 0
    seen: set[int] = set()
    for number in range(300):
        if alive and rng.random() < 0.5:
            array, value = alive.pop(rng.integers(len(alive)))
            assert (array == value).all()
            del array
        shape = [(N, 1), (N // 2, 2), (N, 2), (100,)][rng.integers(4)]
        array = empty(shape, [np.float64, np.float32][rng.integers(2)])
        assert array.shape == shape
        assert array.flags.writeable
        assert array.flags.c_contiguous
        again += array.nbytes >= 1 << 20 and array.ctypes.data in seen
        seen.add(array.ctypes.data)
        array[...] = number
        alive.append((array[:: 1 + number % 2], float(number)))
        assert sum(size * len(memories) for size, memories in reuse._kept.items()) <= 4 * 8 * N
    assert again > 20


def test_nothing_is_kept_outside_the_block_or_beyond_the_limit():
    with reusing_memory():
        first = uninitialised((N,), np.float64)
        assert first.base is None
        allow(2 * 8 * N)
        large = uninitialised((3 * N,), np.float64)
        many = [uninitialised((N,), np.float64) for _ in range(5)]
        del first, large, many
        assert {size: len(memories) for size, memories in reuse._kept.items()} == {8 * N: 2}
        kept = uninitialised((N,), np.float64)
    assert not reuse._kept
    del kept
    assert not reuse._kept
    assert uninitialised((N,), np.float64).base is None


def test_threads_do_not_get_the_same_memory(reused):
    wrong = []

    def work(number):
        for _ in range(200):
            array = uninitialised((N,), np.float64)
            array[::4096] = number
            if not (array[::4096] == number).all():
                wrong.append(number)
            del array

    threads = [threading.Thread(target=work, args=(n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_copies_own_their_memory(reused):
    array = uninitialised((N, 1), np.float64)
    array[:] = 3.0
    other = pickle.loads(pickle.dumps(array))
    del array
    gc.collect()
    uninitialised((N, 1), np.float64)[:] = 5.0
    assert (other == 3.0).all()
