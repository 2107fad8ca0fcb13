"""``warm-up`` leaves no loop to be compiled by a later run."""

from __future__ import annotations

import importlib
import pkgutil
import subprocess
import sys
import warnings

import pytest

pytestmark = pytest.mark.slow


def kernels() -> dict[str, object]:
    """Every compiled loop of the program by its module and name."""
    from numba.core.dispatcher import Dispatcher

    import meshdeform_core
    import meshdeform_formats

    found = {}
    for package in (meshdeform_core, meshdeform_formats):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            for value in vars(importlib.import_module(module.name)).values():
                if isinstance(value, Dispatcher):
                    found[f"{value.py_func.__module__}.{value.py_func.__name__}"] = value
    return found


def unused(loops: dict[str, object]) -> list[str]:
    """Loops that neither ran nor are part of one that did: those called by other loops are compiled into them."""
    known = {id(loop): name for name, loop in loops.items()}
    used, waiting = set(), [name for name, loop in loops.items() if loop.signatures]
    while waiting:
        name = waiting.pop()
        if name not in used:
            used.add(name)
            function = loops[name].py_func
            reached = (function.__globals__.get(word) for word in function.__code__.co_names)
            waiting += [known[id(value)] for value in reached if id(value) in known]
    return sorted(loops.keys() - used)


def test_every_loop_is_used_and_compiled_once():
    """In a process of its own: loops that other tests compile do not count."""
    done = subprocess.run([sys.executable, __file__], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []


def report() -> None:
    """Print the loops that the runs of ``warm-up`` leave out, and those that they compile more than once: plain
    numbers, slices with steps and read-only arrays have signatures of their own."""
    from meshdeform_cli.warm_up_runs import runs

    loops = kernels()
    assert len(unused(loops)) == len(loops) > 150
    # One after the other in this process, so that its loops know what ran.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for run in runs():
            run()
    again = [name for name, loop in loops.items() if len(loop.signatures) > 1]
    print("\n".join([*unused(loops), *again]))


if __name__ == "__main__":
    report()
