"""Room on the disk: foretold, looked for before anything is computed, and at an end at any byte of any output.

A limit on the size of files stands for the full disk: the system refuses to write in the same way.
"""

import gc
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fuzz.bench import called, full_after
from grids import CASE, frame

from meshdeform_core import deform, mending, series
from meshdeform_core.grid import Field, Grid
from meshdeform_formats import write_grid


@pytest.fixture
def disk(monkeypatch):
    """``disk(1000)`` leaves 1000 bytes free."""

    def leave(free: int) -> None:
        monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))

    return leave


@pytest.mark.parametrize("command", ["deform", "repair"])
def test_a_full_disk_is_found_before_the_computation(command, bench, call, disk, snapshot, monkeypatch):
    """A dry run warns in the same words, and writes nothing; of a deformation no report either."""

    def never(*_: object, **__: object) -> None:
        raise AssertionError("computed")

    Path("out.p3dbin").write_bytes(b"an earlier output")
    before = snapshot(bench)
    disk(1000)
    rest = ["-o", "out.p3dbin", "--force", "-c", "case.toml"]
    rest += ["--reference", "grid.xyz"] if command == "repair" else []
    dry = call(command, "grid.xyz", *rest, "--dry-run", *["--report", "out.json"] * (command == "deform"))
    assert (dry.code, "nothing written" in dry.out + dry.err) == (0, True), dry.err
    (warning,) = [text for text in dry.warnings if "1000 B free" in text]
    assert "the grid takes at least" in warning
    for module, name in ((deform, "set_up"), (mending, "mend")):
        monkeypatch.setattr(module, name, never)
    done = call(command, "grid.xyz", *rest)
    assert done.code == 2
    assert warning in done.err
    assert snapshot(bench) == before


def test_a_series_looks_for_room_for_all_levels(bench, call, disk, monkeypatch):
    write_grid(frame(8, 5), "large.xyz")
    options = ("--suffix", ".cgns", "--velocity", "swept", "--variant", "precision=float32")
    words = ("series", "large.xyz", "-c", "case.toml", "-m", "tfi", "--times", "0:2:1", "-o", "out", "-q", *options)
    assert call(*words).code == 0
    size = sum(path.stat().st_size for path in Path("out").rglob("*") if path.is_file())
    with monkeypatch.context() as patch:
        patch.setattr(series, "impose", None)
        disk(size // 2)
        refused = call(*words, "-o", "other")
        assert refused.code == 2
        assert "free, 3 levels of the series take at least" in refused.err
        assert not Path("other").exists()
        dry = call(*words, "-o", "other", "--dry-run")
        assert dry.code == 0
        assert any("3 levels of the series take at least" in warning for warning in dry.warnings)
    disk(size)
    assert call(*words, "-o", "other").code == 0
    # Levels that exist, or are replaced, need no more room.
    disk(size // 2)
    assert call(*words, "--resume").code == 0
    assert call(*words, "--force").code == 0
    for path in Path("out").glob("large_0002*"):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert call(*words, "--resume").code == 0


PARTS = (0.0, 0.3, 1.0)
"""Of the size of the largest file that the command writes."""
MANY_BLOCKS = (".xyz", ".p3dfmt", ".cgns", ".vtm", ".vtu", ".msh", ".med", ".su2", ".inp")


@pytest.fixture
def folder(tmp_path, monkeypatch, own_garbage):
    pytest.importorskip("resource")
    monkeypatch.chdir(tmp_path)
    grid = frame(4, 3)
    Path("case.toml").write_text(CASE)
    write_grid(grid, "grid.xyz")
    write_grid(grid, "grid.cgns")
    rng = np.random.default_rng(0)
    write_grid(
        Grid.from_blocks([rng.random((5, 4, 3, 3))], fields=(Field("p", "node", 0, rng.random((5, 4, 3))),)), "one.vts"
    )
    return tmp_path


def state(folder: Path) -> dict[Path, bytes | None]:
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def fills_up(folder: Path, capfd, *arguments: str, parts: tuple[float, ...] = PARTS) -> None:
    """The command succeeds with room enough, and fails as promised wherever the room ends before."""
    old = state(folder)
    assert called(*arguments)[0] == 0
    new = state(folder)
    written = [len(data) for path, data in new.items() if data is not None and data != old.get(path)]
    for path in sorted(set(new) - set(old), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    for path, data in old.items():
        if data is not None:
            path.write_bytes(data)
    capfd.readouterr()
    for part in parts:
        with full_after(max(0, round(part * max(written)) - 1)):
            code, told = called(*arguments)
        assert code == 2, (part, told)
        assert told.count("meshdeform: error: ") == 1, (part, told)
        assert "Traceback" not in told
        assert "File too large" in told or "written" in told, told
        # What libraries write past Python, and what they say when they are cleaned up.
        gc.collect()
        assert capfd.readouterr() == ("", "")
        assert state(folder) == old, part


# From CGNS there are boundaries, which some formats write into the same file, from VTK fields.
@pytest.mark.parametrize(
    ("suffix", "source"),
    [
        *((suffix, "grid.xyz") for suffix in MANY_BLOCKS),
        *((suffix, "grid.cgns") for suffix in (".cgns", ".xyz", ".msh")),
        *((suffix, "one.vts") for suffix in (".vts", ".vtk", ".cgns", ".xyz")),
    ],
)  # fmt: skip
def test_converted_where_an_old_output_stays(suffix, source, folder, capfd):
    write_grid(Grid.from_blocks([frame(1, 1).block(0)]), "old.xyz")
    assert called("convert", "old.xyz", f"out{suffix}", "-q")[0] == 0
    fills_up(folder, capfd, "convert", source, f"out{suffix}", "-q", "--force")


@pytest.mark.parametrize("name", [
    "report.json", "picture.png", "new.toml",
    *(pytest.param(name, marks=pytest.mark.slow) for name in ("report.html", "report.txt", "picture.pdf")),
])  # fmt: skip
def test_reports_pictures_and_cases(name, folder, capfd):
    command = {"report": "quality", "picture": "plot", "new": "init"}[Path(name).stem]
    option = "--report" if command == "quality" else "-o"
    fills_up(folder, capfd, command, "grid.xyz", option, name, *["-q"] * (command == "quality"), parts=(0.5,))


def test_the_process_ends_quietly(folder):
    """What is left of a file that could not be closed shows when the interpreter exits."""
    code = (
        # Bytecode cut off at the limit would stay and break every later start.
        "import resource, sys; sys.dont_write_bytecode = True; from meshdeform_cli.main import main; "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (5000, resource.RLIM_INFINITY)); main(sys.argv[1:])"
    )
    command = [sys.executable, "-c", code, "convert", "grid.xyz", "out.med"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "meshdeform: error: cannot write out.med: File too large\n"
    assert not list(folder.glob("*out*"))
