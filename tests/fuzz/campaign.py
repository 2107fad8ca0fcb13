"""A fuzz campaign: samples by number, each run in a worker process and judged.

``PYTHONPATH=tests python -m fuzz.campaign N SEED`` runs N samples and prints a table; ``make fuzz N=20000``.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random

import numpy as np

from . import judges
from .mutations import mutated

LIMIT = 30.0
"""Seconds that a file of a few kB may take."""
METHODS = ("tfi", "idw", "rbf", "idw-tfi", "rbf-tfi", "idw-rbf")
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

        self.seed = seed
        self.grid = frame(2, 2)
        one = type(self.grid).from_blocks([self.grid.block(0)])
        for name, grid, options in (
            ("grid.xyz", self.grid, {}),
            ("grid.p3dfmt", self.grid, {"encoding": "ascii"}),
            ("grid.cgns", self.grid, {}),
            ("grid.vts", one, {"encoding": "ascii"}),
            ("grid.vtk", one, {"encoding": "ascii"}),
        ):
            write_grid(grid, name, options)
        Path("case.toml").write_text(CASE)
        near = np.abs(self.grid.points[:, :2]).max(axis=1) < 0.51
        points = np.unique(self.grid.points[near], axis=0)
        rows = np.hstack([points, np.tile([0.05, 0.02, 0.0], (len(points), 1))])
        np.savetxt("table.csv", rows, "%.17g", delimiter=",")
        self.valid = {path.name: path.read_bytes() for path in Path().iterdir()}

    def sample(self, number: int) -> tuple[str, str]:
        """Class and result of a sample: ``ok`` (accepted, right), ``refused``, or what is wrong."""
        rng = Random(f"{self.seed}/{number}")
        kinds: dict[str, Callable[[Random], str]] = {
            "plot3d binary": lambda r: self._file("grid.xyz", False, judges.plot3d_binary, r),
            "plot3d ascii": lambda r: self._file("grid.p3dfmt", True, judges.plot3d_ascii, r),
            "cgns": lambda r: self._file("grid.cgns", False, judges.cgns, r),
            "vts": lambda r: self._file("grid.vts", True, judges.vts, r),
            "vtk": lambda r: self._file("grid.vtk", True, judges.vtk, r),
            "case": self._case,
            "table": self._table,
            "formula": self._formula,
            "grid": self._grid,
        }
        name = list(kinds)[number % len(kinds)]
        return name, kinds[name](rng)

    def _file(self, name: str, text: bool, judge: Callable[..., str], rng: Random) -> str:
        from meshdeform_formats import read_grid

        bad = Path(f"bad{Path(name).suffix}")
        bad.write_bytes(mutated(self.valid[name], text, rng))
        code, told = called("convert", str(bad), "copy.xyz", "--force", "-q")
        if code != 0:
            return refusal(code, told)
        return judge(bad, read_grid(bad)) or "ok"

    def _case(self, rng: Random) -> str:
        Path("bad.toml").write_bytes(mutated(self.valid["case.toml"], True, rng))
        code, told = called("deform", "grid.xyz", "-c", "bad.toml", "-m", "tfi", "-o", "out.xyz", "--force", "-q")
        return "ok" if code in (0, 3) else refusal(code, told)

    def _table(self, rng: Random) -> str:
        from meshdeform_formats import read_grid

        bad = Path("bad.csv")
        bad.write_bytes(mutated(self.valid["table.csv"], True, rng))
        arguments = ("deform", "grid.xyz", "-d", "bad.csv", "-m", "tfi", "-o", "out.xyz", "--force", "-q")
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


def work(first: int, last: int, seed: int) -> None:
    """Run samples and print one JSON line each, and one before each."""

    def too_long(number: int, frame: object) -> None:
        raise TimeoutError(f"more than {LIMIT} s")

    signal.signal(signal.SIGALRM, too_long)
    worker = Worker(seed)
    for number in range(first, last):
        print(json.dumps([number]), flush=True)
        signal.setitimer(signal.ITIMER_REAL, LIMIT)
        try:
            kind, result = worker.sample(number)
        except Exception as error:
            kind, result = "judge", f"{type(error).__name__}: {error}"
        signal.setitimer(signal.ITIMER_REAL, 0)
        print(json.dumps([number, kind, result]), flush=True)


def campaign(count: int, seed: int, first: int = 0) -> Iterator[tuple[int, str, str]]:
    """Number, class and result of every sample; a worker that dies is a result too."""
    end = first + count
    while first < end:
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "fuzz.campaign", "--work", str(first), str(end), str(seed)]
            environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1]), "PYTHONSAFEPATH": "1"}
            with subprocess.Popen(
                command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
            ) as process:
                for line in process.stdout:
                    entry = json.loads(line)
                    first = entry[0]
                    if len(entry) == 3:
                        yield tuple(entry)
                        first += 1
                ended = process.wait()
            if ended != 0:
                yield first, "worker", f"ended with {ended}"
                first += 1


def main() -> int:
    """Run a campaign from the command line and print its table."""
    if sys.argv[1:2] == ["--work"]:
        work(*(int(word) for word in sys.argv[2:5]))
        return 0
    count, seed = int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else int(time.time())
    totals: Counter[tuple[str, str]] = Counter()
    wrong = []
    for number, kind, result in campaign(count, seed):
        totals[kind, result if result in ("ok", "refused") else "wrong"] += 1
        if result not in ("ok", "refused"):
            wrong.append((number, kind, result))
            print(f"sample {number} of seed {seed} ({kind}): {result}", flush=True)
    print(f"| class (seed {seed}) | samples | right | refused | wrong |\n|---|---|---|---|---|")
    for kind in sorted({kind for kind, _ in totals}):
        counts = [totals[kind, result] for result in ("ok", "refused", "wrong")]
        print(f"| {kind} | {sum(counts)} | {' | '.join(map(str, counts))} |")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
