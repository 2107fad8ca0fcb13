"""Work beside other work: begun at once with two threads, when it is asked for with one; errors arrive in any case."""

import subprocess
import sys
import threading

import pytest
from pretended import rank

from meshdeform_core.parallel import Task, set_threads, tasks_running


@pytest.fixture(params=[1, 2])
def threads(request):
    set_threads(request.param)
    yield request.param
    set_threads(None)


def test_with_two_threads_it_runs_beside_with_one_when_its_result_is_needed(threads):
    here, begun = threading.current_thread(), threading.Event()

    def make():
        begun.set()
        return threading.current_thread()

    task = Task(make)
    assert begun.wait(10 if threads == 2 else 0) == (threads == 2)
    assert (task.result() is here) == (threads == 1)
    assert task.result() is task.result()


def test_several_ranks_make_everything_in_order():
    set_threads(2)
    try:
        with rank(0, 2, []):
            done = []
            task = Task(lambda: done.append("task"))
            done.append("beside")
            task.result()
    finally:
        set_threads(None)
    assert done == ["beside", "task"]


def test_what_it_raises_is_raised_where_its_result_is_needed(threads):
    def make():
        raise KeyError("lost")

    task = Task(make)
    for _ in range(2):
        with pytest.raises(KeyError, match="lost"):
            task.result()


def test_it_is_known_which_tasks_are_still_running():
    set_threads(2)
    try:
        go_on = threading.Event()
        task = Task(go_on.wait)
        assert tasks_running()
        go_on.set()
        assert task.result()
    finally:
        set_threads(None)
    assert not tasks_running()


ABANDONED = """
import sys, time
from meshdeform_cli import main as entry
from meshdeform_core.parallel import Task, set_threads

def run(args):
    set_threads(2)
    Task(lambda: time.sleep(60))
    print("failed", flush=True)
    return 2

entry.run = run
entry.main([])
"""


def test_a_command_that_fails_waits_for_no_task():
    done = subprocess.run([sys.executable, "-c", ABANDONED], capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stdout, done.stderr) == (2, "failed\n", "")
