"""A bench for commands: a folder with small good files to work in, and a way to call the program in-process."""

import dataclasses
import re
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from grids import CASE, frame, frame_2d, with_walls
from started_ranks import start

from meshdeform_cli.main import run
from meshdeform_formats import write_grid


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What a command left behind: exit code, stdout, stderr."""

    code: int
    out: str
    err: str

    @property
    def warnings(self) -> list[str]:
        """What it warned of."""
        lead = "meshdeform: warning: "
        return [line.removeprefix(lead) for line in self.err.splitlines() if line.startswith(lead)]

    @property
    def error(self) -> str:
        """What else it told on stderr."""
        lines = self.err.splitlines(keepends=True)
        return "".join(line for line in lines if not line.startswith("meshdeform: warning: "))


Call = Callable[..., Outcome]


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Call:
    """``call("info", "grid.xyz")`` runs a command in this process."""

    def called(*args: object) -> Outcome:
        capsys.readouterr()
        code = run([str(arg) for arg in args])
        out, err = capsys.readouterr()
        # Which test is the first to compile a loop is nobody's business.
        return Outcome(code, out, re.sub("meshdeform: compiling [0-9]+ loops? in .*\n", "", err))

    return called


@pytest.fixture(scope="session")
def compiled() -> None:
    """Loops read from the disk: those that a process has just compiled can differ from them in the last bit."""
    done = start(sys.executable, "-m", "meshdeform_cli", "warm-up", limit=600)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="session")
def _template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bench")
    grid = frame()
    write_grid(grid, folder / "grid.xyz")
    write_grid(grid, folder / "grid.p3dfmt", {"encoding": "ascii"})
    write_grid(with_walls(grid), folder / "grid.cgns")
    write_grid(frame_2d(), folder / "flat.p2dfmt", {"encoding": "ascii", "dimension": "2"})
    (folder / "case.toml").write_text(CASE)
    points = grid.points[np.abs(grid.points[:, :2]).max(axis=1) < 0.51]
    table = np.hstack([points, np.tile([0.1, 0.0, 0.0], (len(points), 1))])
    np.savetxt(folder / "table.csv", np.unique(table, axis=0), "%.17g", delimiter=",", header="x,y,z,dx,dy,dz")
    (folder / "old.xyz").write_bytes(b"an old result")
    (folder / "old.json").write_text("an old report")
    return folder


@pytest.fixture
def bench(_template: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The current folder, with grid.xyz, grid.p3dfmt, grid.cgns, flat.p2dfmt, case.toml, table.csv and old results."""
    folder = tmp_path / "bench"
    shutil.copytree(_template, folder)
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def snapshot() -> Callable[[Path], dict[str, bytes | None]]:
    """Every path below a folder with its bytes: what must not change when a command refuses."""
    return lambda folder: {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }
