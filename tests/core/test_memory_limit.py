"""What a memory limit leaves for work that only saves time."""

from meshdeform_core import memory
from meshdeform_core.memory import UNLIMITED, MemoryLimit


def test_a_quarter_may_be_taken_while_the_rest_is_in_its_bounds(monkeypatch):
    left = MemoryLimit(1000, "--max-memory allows").after(600, "program and grid")
    for peak, spare in ((0, 100), (600, 100), (800, 100), (850, 50), (950, -50), (1200, -300)):
        monkeypatch.setattr(memory, "peak_memory", lambda peak=peak: peak)
        assert left.spare == spare
    assert UNLIMITED.spare > 2**59


def test_what_is_set_apart_adds_up():
    left = MemoryLimit(1000, "--max-memory allows").after(300, "one").after(200, "two")
    assert (left.size, left.taken) == (500, 500)
