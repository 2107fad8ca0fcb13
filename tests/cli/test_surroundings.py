"""Surroundings, names and inputs that other programs would stumble over: one message, or no difference."""

import os
import signal
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
from grids import frame

from meshdeform_cli import looking, main, process
from meshdeform_core import interruption
from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid
from meshdeform_formats import read_grid, write_grid

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
@pytest.mark.parametrize("driver", ["nonsense", "core"])
def test_libraries_set_up_for_other_programs_and_warnings_that_are_errors(driver, bench):
    """A display that does not exist; a driver that HDF5 does not know, at which it crashes, or that writes no file."""
    strange = {"MPLBACKEND": "nonsense", "HDF5_DRIVER": driver, "PYTHONWARNINGS": "error"}
    done = program("deform", "grid.cgns", "-c", "case.toml", "-o", "out.cgns", "--report", "r.html", "-q", **strange)
    assert (done.returncode, done.stderr) == (0, "")
    assert (bench / "out.cgns").stat().st_size > 0


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


STRANGE = os.fsdecode(b"gr\xff d")


@pytest.mark.parametrize("suffix", [".xyz", ".cgns", ".vts"])
def test_names_that_are_not_utf8(bench, call, suffix):
    grid = Grid.from_blocks([frame().block(0)])
    write_grid(grid, STRANGE + suffix)
    done = call("convert", STRANGE + suffix, f"again{STRANGE}{suffix}", "-q")
    assert (done.code, done.err) == (0, "")
    np.testing.assert_array_equal(read_grid(f"again{STRANGE}{suffix}").points, grid.points)


@contextmanager
def as_nobody() -> Iterator[None]:
    """The rights of a user to whom nothing here belongs."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.mark.parametrize("name", ["a.xyz", "a.cgns", "a.vtm"])
def test_no_permission_is_said(tmp_path, name):
    for path in (tmp_path, *tmp_path.parents):
        if path.name.startswith(("pytest-of-", "pytest-", "popen-", "test_")):
            path.chmod(0o755)
    grid = Grid.from_blocks([frame().block(0)])
    write_grid(grid, tmp_path / name)
    (tmp_path / "closed").mkdir(mode=0o755)
    (tmp_path / name).chmod(0)
    (tmp_path / "closed").chmod(0o555)
    with as_nobody():
        if os.access(tmp_path / name, os.R_OK, effective_ids=True):
            pytest.skip("this user may read everything")
        with pytest.raises(FormatError, match=f"cannot read .*{name}: Permission denied$"):
            read_grid(tmp_path / name)
        with pytest.raises(FormatError, match=f"cannot write .*{name}: Permission denied$"):
            write_grid(grid, tmp_path / "closed" / name)
    assert not list((tmp_path / "closed").iterdir())


CASELESS = ("deform", "grid.xyz", "-o", "out.xyz")


def test_long_words_and_paths_of_a_case_are_no_deep_keys(bench, call):
    text = (bench / "case.toml").read_text()
    (bench / "long.toml").write_text("# " + "/".join(["a.b"] * 50) + "\n# " + "word" * 50_000 + "\n" + text)
    assert call(*CASELESS, "-c", "long.toml", "-q").code == 0


def test_a_table_that_declares_gigabytes_of_zeros_is_refused_before_it_is_unpacked(tmp_path, bench, call):
    header = np.lib.format
    with zipfile.ZipFile(bench / "zeros.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name in ("points", "displacement"):
            with archive.open(f"{name}.npy", "w") as member:
                count = 6 << 20
                header.write_array_header_1_0(member, {"descr": "<f8", "fortran_order": False, "shape": (count, 3)})
                for _ in range(24):
                    member.write(bytes(count))
    result = call(*CASELESS, "-d", "zeros.npz")
    assert result.code == 2
    assert "which no table of displacements does" in result.err


def test_a_signal_within_a_callback_of_the_collector_prints_no_traceback(monkeypatch, capsys):
    """Python cannot deliver the exception there; the next check ends the program."""
    monkeypatch.setattr(interruption, "_requests", [signal.SIGINT])
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    lost = SimpleNamespace(
        exc_type=SystemExit, exc_value=SystemExit(130), exc_traceback=None, err_msg=None, object=None
    )
    process._unraisable(lost)
    assert capsys.readouterr().err == ""
    with pytest.raises(SystemExit):
        interruption.check()


def test_a_file_that_ends_too_early_for_a_library_is_no_interrupt(call, bench, monkeypatch):
    """click turns EOFError into what Ctrl-C raises."""

    def broken(**_: object) -> None:
        raise EOFError("marshal data too short")

    monkeypatch.setattr(looking.info_command, "callback", broken)
    result = call("info", "grid.xyz")
    assert result.code == 1
    assert "marshal data too short" in result.err
    assert "interrupted" not in result.err
