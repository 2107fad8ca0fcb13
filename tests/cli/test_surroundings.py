"""Environment variables, folders and outputs that other programs would stumble over: one message, or no difference."""

from __future__ import annotations

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from meshdeform_cli import main

DEFORM = ("deform", "grid.xyz", "-c", "case.toml", "-q")


def program(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """A command in a process of its own, which ends within a minute."""
    command = [sys.executable, "-m", "meshdeform_cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, env=os.environ | variables)


@pytest.mark.parametrize("value", ["0", "many"])
def test_number_of_threads_that_numba_refuses(value, bench):
    done = program(*DEFORM, "-o", "out.xyz", NUMBA_NUM_THREADS=value)
    assert done.returncode == 2
    assert done.stderr.startswith(f"meshdeform: error: NUMBA_NUM_THREADS={value}: expected a whole number >= 1")


@pytest.mark.slow
def test_libraries_set_up_for_other_programs(bench):
    """A display that does not exist and a driver that HDF5 does not know, at which it crashes."""
    done = program("plot", "grid.cgns", "-o", "grid.png", "-q", MPLBACKEND="nonsense", HDF5_DRIVER="nonsense")
    assert (done.returncode, done.stderr) == (0, "")
    done = program(*DEFORM, "-o", "out.cgns", HDF5_DRIVER="core")
    assert done.returncode == 0
    assert (bench / "out.cgns").stat().st_size > 0


@pytest.mark.slow
def test_warnings_that_python_turns_into_errors(bench):
    done = program(
        "deform", "grid.cgns", "-c", "case.toml", "-o", "out.cgns", "--report", "r.html", PYTHONWARNINGS="error"
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        (*DEFORM, "-o", "pipe.vtm"), (*DEFORM, "-o", "link.xyz"), (*DEFORM, "-o", "out.xyz", "--report", "pipe.json"),
        ("plot", "grid.xyz", "-o", "pipe.png"), ("init", "grid.xyz", "-o", "pipe.toml"),
    ],
    ids=lambda arguments: f"{arguments[0]}-{arguments[-1]}",
)  # fmt: skip
def test_a_pipe_is_no_output(arguments, bench, call):
    """It is neither replaced by a file nor waited for."""
    name = "pipe.xyz" if arguments[-1].startswith("link") else arguments[-1]
    os.mkfifo(name)
    os.symlink("pipe.xyz", "link.xyz")
    done = call(*arguments, "--force")
    assert done.code == 2
    assert "it is a pipe; give a file name" in done.err
    assert (bench / name).is_fifo()
    assert not (bench / "out.xyz").exists()


def test_a_folder_that_was_removed(bench):
    code = (
        "import os, runpy, sys; os.mkdir('gone'); os.chdir('gone'); os.rmdir('../gone'); "
        "sys.argv = ['meshdeform', 'deform', sys.argv[1], '-c', sys.argv[2], '-o', 'x.xyz']; "
        "runpy.run_module('meshdeform_cli', run_name='__main__')"
    )
    files = [str(bench / name) for name in ("grid.xyz", "case.toml")]
    done = subprocess.run([sys.executable, "-c", code, *files], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert "error: the current folder does not exist any more" in done.stderr


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_what_the_last_flush_cannot_write_is_an_error(monkeypatch, capsys):
    """A library may print without flushing; the loss shows only when the program ends."""
    monkeypatch.setattr(main, "cli", SimpleNamespace(main=lambda **_: print("done", end="")))
    with open("/dev/full", "w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert main.run([]) == 2
    assert capsys.readouterr().err == "meshdeform: error: cannot write to stdout: No space left on device\n"
