"""The samples of a campaign: what each class makes, runs and judges."""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import h5py
import numpy as np
from cgns_witness import AdfWriter, two_zones

from . import judges
from .mutations import mutated

METHODS = ("tfi", "idw", "rbf", "idw-tfi", "rbf-tfi", "idw-rbf")
KEYS = (
    "constants.turn",
    "constants.new",
    "grid.tolerance",
    "grid.open",
    "method.name",
    "method.idw.alpha",
    "method.idw.rotation",
    "method.idw.length",
    "method.idw.b",
    "method.rbf.radius",
    "method.rbf.basis",
    "method.tfi.max_cells",
    "boundary.1.kind",
    "boundary.1.where",
    "boundary.2.select",
    "repair.mode",
)
VALUES = (
    "0", "-1", "1e-300", "1e300", "nan", "inf", "true", "[]", "{}", "''", "'auto'", "'x > 0'", "'lie'", "'tps'", "1.5",
    "'*.kmin'", "['block1.imax']", "'slip'", "'wendland-c2'", "'off'", "40", "[[", "3", "'x" + "(" * 300 + "'", "1e-3",
)  # fmt: skip
CASE = """[constants]
turn = 10.0
[[boundary]]
name = "body"
select = ["*.i*", "*.j*"]
where = "abs(x) < 0.51 and abs(y) < 0.51"
motion = [{ rotate = { angle = "turn", axis = [0, 0, 1], center = [0, 0, 0] } }]
[[boundary]]
name = "span"
select = ["*.kmin", "*.kmax"]
kind = "slip"
[[boundary]]
name = "outer"
select = ["*.i*", "*.j*"]
where = "max(abs(x), abs(y)) > 1.99"
kind = "fixed"
"""


class Worker:
    """Makes and judges samples in a folder of its own."""

    def __init__(self, seed: int):
        from grids import frame

        from meshdeform_formats import write_grid
        from meshdeform_formats.grids import complete_for_export
        from meshdeform_formats.neutral_map import write_neutral_map

        self.seed = seed
        self.grid = frame(2, 2)
        one = type(self.grid).from_blocks([self.grid.block(0)])
        for name, grid, options in (
            ("grid.xyz", self.grid, {}),
            ("grid.bin", self.grid, {"encoding": "binary"}),
            ("grid.p3dfmt", self.grid, {"encoding": "ascii"}),
            ("grid.cgns", self.grid, {}),
            ("grid.vts", one, {"encoding": "ascii"}),
            ("raw.vts", one, {"encoding": "appended", "compression": "none"}),
            ("packed.vts", one, {"encoding": "binary", "compression": "zlib"}),
            ("grid.vtk", one, {"encoding": "ascii"}),
            ("raw.vtk", one, {"encoding": "binary"}),
            ("set.vtm", self.grid, {"encoding": "ascii"}),
        ):
            write_grid(grid, name, options)
        AdfWriter().write(Path("grid.adf"), two_zones())
        Path("case.toml").write_text(CASE)
        near = np.abs(self.grid.points[:, :2]).max(axis=1) < 0.51
        points = np.unique(self.grid.points[near], axis=0)
        moves = np.tile([0.05, 0.02, 0.0], (len(points), 1))
        np.savetxt("table.csv", np.hstack([points, moves]), "%.17g", delimiter=",")
        np.save("table.npy", np.hstack([points, moves]))
        np.savez("table.npz", points=points, displacement=moves)
        with h5py.File("table.h5", "w") as file:
            file["points"], file["displacement"] = points, moves
        write_neutral_map(complete_for_export(self.grid, Path("grid.cgns")), Path("grid.nmf"))
        self.valid = {path.name: path.read_bytes() for path in Path().iterdir() if path.is_file()}
        self.kinds: dict[str, Callable[[Random], str]] = {
            "plot3d Fortran": lambda r: self._file("grid.xyz", False, judges.plot3d_binary, r),
            "plot3d stream": lambda r: self._file("grid.bin", False, judges.plot3d_binary, r),
            "plot3d ASCII": lambda r: self._file("grid.p3dfmt", True, judges.plot3d_ascii, r),
            "CGNS, HDF5": lambda r: self._file("grid.cgns", False, judges.cgns, r),
            "CGNS, ADF": lambda r: self._file("grid.adf", False, judges.adf, r),
            ".vts ASCII": lambda r: self._file("grid.vts", True, judges.vts, r),
            ".vts raw": lambda r: self._file("raw.vts", False, judges.vts_raw, r),
            ".vts zlib": lambda r: self._file("packed.vts", True, judges.vts_packed, r),
            ".vtk ASCII": lambda r: self._file("grid.vtk", True, judges.vtk, r),
            ".vtk binary": lambda r: self._file("raw.vtk", False, judges.vtk_raw, r),
            ".vtm": lambda r: self._file("set.vtm", True, judges.vtm, r),
            "neutral map": self._neutral_map,
            "case": self._case,
            "options": self._options,
            "table, text": lambda r: self._table("table.csv", True, r),
            "table, numpy": lambda r: self._table(r.choice(("table.npy", "table.npz")), False, r),
            "table, HDF5": lambda r: self._table("table.h5", False, r),
            "formula": self._formula,
            "grid": self._grid,
        }

    def warm_up(self) -> None:
        """Run every method once."""
        for method in METHODS:
            self._judged("grid.xyz", self.grid, "-c", "case.toml", "-m", method)

    def sample(self, number: int) -> tuple[str, str]:
        """Class and result of a sample: ``ok`` (accepted, right), ``refused``, or what is wrong."""
        rng = Random(f"{self.seed}/{number}")
        name = list(self.kinds)[number % len(self.kinds)]
        return name, self.kinds[name](rng)

    def _file(self, name: str, text: bool, judge: Callable[..., str], rng: Random) -> str:
        from meshdeform_formats import read_grid

        bad = Path(f"bad{Path(name).suffix}")
        bad.write_bytes(mutated(self.valid[name], text, rng))
        code, told = called("convert", str(bad), "copy.xyz", "--force", "-q")
        if code != 0:
            return refusal(code, told)
        return judge(bad, read_grid(bad)) or "ok"

    def _neutral_map(self, rng: Random) -> str:
        """What its connections join lies at one place, or is told."""
        from meshdeform_formats.grids import read_grid_with_boundaries

        Path("bad.nmf").write_bytes(mutated(self.valid["grid.nmf"], True, rng))
        arguments = ("deform", "grid.xyz", "--boundary-file", "bad.nmf", "-c", "case.toml", "-m", "tfi")
        code, told = called(*arguments, "-o", "out.xyz", "--force", "-q")
        if code not in (0, 3):
            return refusal(code, told)
        grid = read_grid_with_boundaries(Path("grid.xyz"), Path("bad.nmf"))
        return judges.neutral_map(Path("bad.nmf"), grid, told) or "ok"

    def _case(self, rng: Random) -> str:
        Path("bad.toml").write_bytes(mutated(self.valid["case.toml"], True, rng))
        return self._judged("grid.xyz", self.grid, "-c", "bad.toml", "-m", "tfi")

    def _options(self, rng: Random) -> str:
        """A good case with one key from the command line, most often a wrong one."""
        key = rng.choice(KEYS)
        value = rng.choice(VALUES)
        return self._judged("grid.xyz", self.grid, "-c", "case.toml", "-s", f"{key}={value}", "-m", rng.choice(METHODS))

    def _judged(self, source: str, before: Any, *arguments: str) -> str:
        """A deformation that exits with 0 must be finite and valid."""
        from meshdeform_formats import read_grid

        code, told = called("deform", source, *arguments, "-o", "out.xyz", "--force", "-q")
        if code != 0:
            return "ok" if code == 3 else refusal(code, told)
        after = read_grid("out.xyz")
        if not np.isfinite(after.points).all():
            return "coordinates that are not finite"
        bad = judges.newly_bad(before, after)
        return "ok" if bad == 0 else f"{bad} cells became invalid and the exit code is 0"

    def _table(self, name: str, text: bool, rng: Random) -> str:
        from meshdeform_formats import read_grid

        bad = Path("bad").with_suffix(Path(name).suffix)
        bad.write_bytes(mutated(self.valid[name], text, rng))
        arguments = ("deform", "grid.xyz", "-d", str(bad), "-m", "tfi", "-o", "out.xyz", "--force", "-q")
        code, told = called(*arguments, "--allow-invalid")
        return judges.table(bad, self.grid, read_grid("out.xyz")) or "ok" if code == 0 else refusal(code, told)

    def _formula(self, rng: Random) -> str:
        from meshdeform_core.boundary.expression import expression
        from meshdeform_core.errors import CaseError

        text = formula(rng, 4)
        values = {"x": np.linspace(-2, 2, 9), "y": np.linspace(1, 3, 9)}
        names = {name: getattr(np, name) for name in ("sin", "cos", "exp", "tanh", "abs", "floor", "hypot")}
        try:
            got = np.asarray(expression(text, values)(values), dtype=float)
        except CaseError as error:
            return "ok" if len(text) > 1000 else f"refused a formula: {error}"
        with np.errstate(all="ignore"):
            expected = np.asarray(eval(text, {"__builtins__": {}}, {**names, **values, "pi": np.pi}), dtype=float)
        both = np.isfinite(got) & np.isfinite(expected)
        same = np.allclose(*(np.broadcast_to(v, 9)[np.broadcast_to(both, 9)] for v in (got, expected)), rtol=1e-12)
        return "ok" if same and (np.isfinite(got) == np.isfinite(expected)).all() else f"{text} gives {got}"

    def _grid(self, rng: Random) -> str:
        from meshdeform_core.grid import Grid
        from meshdeform_formats import read_grid, write_grid

        grid, shift = nasty(rng), rng.choice((0.01, 0.1, 1.0))
        write_grid(grid, "nasty.xyz")
        grid = read_grid("nasty.xyz")
        entry = f"boundary=[{{name='w',select=['*.jmin'],motion=[{{displace=['{shift}*y','{shift}*x','0']}}]}}]"
        method = rng.choice(METHODS)
        arguments = ("deform", "nasty.xyz", "-s", entry, "-m", method, "-o", "out.xyz", "--force", "-q")
        code, told = called(*arguments, "-s", "grid.open=true", "--steps", rng.choice(("1", "2", "auto")))
        if code != 0:
            return "ok" if code == 3 else refusal(code, told)
        after: Grid = read_grid("out.xyz")
        if not np.isfinite(after.points).all():
            return "coordinates that are not finite"
        wall = grid.block(0)[:, 0].reshape(-1, 3)
        told_wall = wall + shift * np.stack([wall[:, 1], wall[:, 0], 0 * wall[:, 0]], axis=1)
        if np.abs(after.block(0)[:, 0].reshape(-1, 3) - told_wall).max() > 1e-9:
            return "the wall is not where it was told"
        bad = judges.newly_bad(grid, after)
        return "ok" if bad == 0 else f"{bad} cells became invalid and the exit code is 0"


def nasty(rng: Random):
    """A small grid of one or two blocks with irregular, collapsed or folded cells."""
    from meshdeform_core.grid import Grid

    random = np.random.default_rng(rng.randrange(2**32))
    lines = [np.cumsum(np.r_[0.0, random.uniform(0.05, 1.0, rng.randrange(1, 5))]) for _ in range(3)]
    block = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)
    block += rng.choice((0.0, 0.02, 0.2)) * random.uniform(-1, 1, block.shape)
    what = rng.randrange(5)
    if what == 1:
        block[0] = block[0].mean(axis=0)
    elif what == 2:
        block[:, :, 0] = block[0, :, 0]
    elif what == 3:
        block = block[::-1]
    blocks = [block]
    if rng.random() < 0.5:
        blocks.append(np.concatenate([block[-1:], block[-1:] + [1.0, 0.0, 0.0]]))
    return Grid.from_blocks([np.ascontiguousarray(b) for b in blocks])


def formula(rng: Random, depth: int) -> str:
    """A random formula of x and y."""
    if depth == 0 or rng.random() < 0.2:
        return rng.choice(("x", "y", "pi", str(rng.randrange(9)), f"{rng.uniform(-3, 3):.3g}"))
    one, two = (formula(rng, depth - 1) for _ in range(2))
    shape = rng.randrange(5)
    if shape == 0:
        return f"({one} / (1.5 + cos({two})))"
    if shape < 3:
        return f"({one} {rng.choice('+-*')} {two})"
    if shape == 3:
        return f"{rng.choice(('sin', 'cos', 'exp', 'tanh', 'abs', 'floor'))}({one})"
    return f"hypot({one}, {two})"


def called(*arguments: str) -> tuple[int, str]:
    """Exit code and messages of a command in this process; Python's own warnings count as bugs."""
    from meshdeform_cli.main import run

    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out), warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        code = run(list(arguments))
    return code, out.getvalue()


def refusal(code: int, told: str) -> str:
    if code == 2 and "meshdeform: error: " in told and "Traceback" not in told:
        return "refused"
    return f"exit code {code}: {' | '.join(told.splitlines()[-3:])[:300]}"
