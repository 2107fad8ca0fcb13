"""Ranks that are forks of this process, which passes on what they exchange: several ranks without MPI."""

import contextlib
import multiprocessing
import pickle
import traceback

import numpy as np

from meshdeform_core.numerics import pieces
from meshdeform_core.parallel import Ranks, empty, nodes, sharing

_PATIENCE = 120.0
_FORK = multiprocessing.get_context("fork")


class ForkedRank(Ranks):
    """One of several ranks, as far as arrays in parts need them."""

    cores = 1

    def __init__(self, number, count, hub):
        self.number, self.count, self._hub = number, count, hub

    def _exchange(self, what):
        """What every rank has sent, in rank order."""
        self.meet()
        self._hub.send_bytes(pickle.dumps(what))
        return [pickle.loads(self._hub.recv_bytes()) for _ in range(self.count)]

    def gather(self, found):
        return [each for own in self._exchange(list(found)) for each in own]

    def collect(self, own, counts=None):
        found = self._exchange(own)
        sizes = [len(each) for each in found]
        assert counts is None or sizes == list(counts)
        every = empty((sum(sizes), *own.shape[1:]), own.dtype)
        return np.concatenate(found, out=every)

    def swap(self, sends, receives):
        sent = self._exchange(sends)
        for number, array in receives.items():
            array[...] = sent[number].get(self.number, array)

    def on_first(self, action):
        result = failure = None
        if self.number == 0:
            try:
                with sharing(threads=1, apart=True):
                    result = action()
            except Exception as error:
                failure = error
        result, failure = self._exchange((result, failure))[0]
        if failure:
            raise failure
        return result


class Failed(Exception):
    """What a rank failed with: the text of its error."""


def on_ranks(count, action):
    """The results of ``action(ranks)`` on each of several ranks.

    Raises
    ------
    Failed
        When one of them fails.
    """
    hubs, ranks = zip(*(_FORK.Pipe() for _ in range(count)), strict=True)
    forks = [_FORK.Process(target=_run, args=(number, count, ranks[number], action)) for number in range(count)]
    for fork in forks:
        fork.start()
    try:
        while True:
            # Messages are passed on as they are; an empty one announces the result of a rank, or its error.
            sent = [_received(hub, forks) for hub in hubs]
            if not all(sent):
                ends = [hub.recv() for hub, message in zip(hubs, sent, strict=True) if not message]
                for _, failure in ends:
                    if failure:
                        raise Failed(failure)
                assert len(ends) == count, "some ranks have ended, others exchange data"
                return [result for result, _ in ends]
            for hub in hubs:
                for message in sent:
                    hub.send_bytes(message)
    finally:
        for fork in forks:
            fork.kill()
            fork.join()


def _run(number, count, hub, action):
    try:
        with sharing(threads=1):
            result, failure = action(ForkedRank(number, count, hub)), ""
    except BaseException:
        result, failure = None, traceback.format_exc()
    hub.send_bytes(b"")
    hub.send((result, failure))


def _received(hub, forks):
    if not hub.poll(_PATIENCE):
        raise Failed(f"a rank waits in vain; alive: {[fork.is_alive() for fork in forks]}")
    return hub.recv_bytes()


def poison_parts(monkeypatch):
    """What a rank does not hold of an array in parts is no number."""
    blank = nodes.blank

    def poison(shape, dtype):
        array = blank(shape, dtype)
        array[...] = np.nan if np.dtype(dtype).kind == "f" else 77
        return array

    monkeypatch.setattr(nodes, "blank", poison)


@contextlib.contextmanager
def small_blocks_are_cut(monkeypatch, least=100, cells=4):
    """Blocks are cut into pieces of about ``least`` nodes between planes ``cells`` apart, although they are small."""
    monkeypatch.setattr(pieces, "_NODES", least)
    monkeypatch.setattr(pieces, "_CELLS", cells)
    pieces._ends.cache_clear()
    yield
    pieces._ends.cache_clear()
