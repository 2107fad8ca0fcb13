"""A folder with small good files, and a way to call the program in this process."""

import contextlib
import io
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from grids import CASE, frame

from meshdeform_core.grid import Grid
from meshdeform_formats import read_grid, write_grid

METHODS = ("tfi", "idw", "rbf", "idw-tfi", "rbf-tfi", "idw-rbf")


class Bench:
    """The current folder with ``grid.xyz`` and ``case.toml``, and the bytes of every file that is valid."""

    def __init__(self) -> None:
        self.grid = frame(2, 2)
        write_grid(self.grid, "grid.xyz")
        Path("case.toml").write_text(CASE)
        self.valid: dict[str, bytes] = {}

    def keep(self) -> None:
        """Remember the files of the folder as valid."""
        self.valid |= {path.name: path.read_bytes() for path in Path().iterdir() if path.is_file()}

    def deformed(self, before: Grid, case: str | None, *arguments: str) -> str:
        """A deformation into out.xyz that exits with 0 is finite and valid, its walls where ``case`` puts them."""
        from .judges import newly_bad, walls_told

        code, told = called("deform", *arguments, "-o", "out.xyz", "--force", "-q")
        if code != 0:
            return "ok" if code == 3 else refusal(code, told)
        after = read_grid("out.xyz")
        if not np.isfinite(after.points).all():
            return "coordinates that are not finite"
        bad = newly_bad(before, after)
        if bad:
            return f"{bad} cells became invalid and the exit code is 0"
        try:
            return (walls_told(case, before, after) if case is not None else "") or "ok"
        except FloatingPointError:
            return "ok"


def called(*arguments: str) -> tuple[int, str]:
    """Exit code and messages of a command in this process; Python's own warnings count as bugs."""
    from meshdeform_cli.main import run

    out, told = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(told), warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        code = run(list(arguments))
    return code, out.getvalue() + told.getvalue()


def refusal(code: int, told: str) -> str:
    """``refused`` if a command ended with one message and exit code 2, else what it did."""
    if code == 2 and told.count("meshdeform: error: ") == 1 and "Traceback" not in told:
        return "refused"
    return f"exit code {code}: {' | '.join(told.splitlines()[-3:])[:300]}"


def seeded(rng: Random) -> np.random.Generator:
    """A generator of arrays that depends on ``rng``."""
    return np.random.default_rng(rng.randrange(2**32))


def picked(rng: Random, **choices: Any) -> dict[str, Any]:
    """One value of each."""
    return {name: rng.choice(values) for name, values in choices.items()}


@contextlib.contextmanager
def full_after(size: int) -> Iterator[None]:
    """No file grows beyond ``size`` bytes, as on a disk that is full."""
    import resource  # of POSIX systems

    before, without = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    # Bytecode cut off at the limit would stay and break every later start.
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = without
