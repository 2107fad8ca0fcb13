"""Classes of runs within limits: a full disk."""

from __future__ import annotations

import contextlib
import functools
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from random import Random

import numpy as np

from meshdeform_core.grid import Grid
from meshdeform_formats import read_grid

from .bench import Bench, called, refusal

try:
    import resource
except ImportError:
    # Windows has no limits of this kind.
    resource = None  # type: ignore[assignment]

NO_SUCH = "skipped"
_BESIDE = Path(sys.executable).with_name("mpiexec")
MPIEXEC = str(_BESIDE) if _BESIDE.exists() else shutil.which("mpiexec")
SUFFIXES = (".xyz", ".p3dfmt", ".cgns", ".vtm", ".vtu", ".msh")


@contextlib.contextmanager
def full_after(size: int) -> Iterator[None]:
    """No file grows beyond ``size`` bytes."""
    before, without = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    # Bytecode cut off at the limit would stay and break every later start.
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = without


def full_disk(bench: Bench, rng: Random) -> str:
    """With room for a part of the output the old file stays; with enough, the new one is there."""
    if resource is None:
        return NO_SUCH
    folder, suffix = Path("disk"), rng.choice(SUFFIXES)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    out = folder / f"out{suffix}"
    if rng.random() < 0.5:
        assert called("convert", "grid.xyz", str(out), "-q")[0] == 0
    arguments = rng.choice(
        (
            ("convert", rng.choice(("grid.xyz", "grid.cgns", "set.vtm")), str(out), "--force", "-q"),
            ("deform", "grid.xyz", "-c", "case.toml", "-m", "tfi", "-o", str(out), "--force", "-q"),
            ("deform", "grid.xyz", "-c", "case.toml", "-m", "tfi", "-o", str(out), "--force", "-q",
             "--report", f"{folder}/out.{rng.choice(('json', 'html', 'txt', 'md'))}"),
        )
    )  # fmt: skip
    before = _contents(folder)
    with full_after(int(10 ** rng.uniform(1, 5))):
        code, told = called(*arguments)
    after = _contents(folder)
    if code == 2:
        # The grid may be complete where only the report had no room.
        changed = {path for path in before.keys() | after.keys() if before.get(path) != after.get(path)}
        if not changed or ("--report" in arguments and not any("out." + "partial" in str(path) for path in changed)):
            return refusal(code, told)
        return f"{sorted(map(str, changed))} changed though the disk was full"
    if code != 0:
        return refusal(code, told)
    if suffix in (".vtu", ".msh"):
        return "ok" if out.stat().st_size > 0 else "an empty file"
    expected = bench.grid if arguments[0] == "convert" else _plainly_deformed()
    return "ok" if np.allclose(read_grid(out).points, expected.points, rtol=0, atol=1e-12) else "another grid"


@functools.cache
def _plainly_deformed() -> Grid:
    assert called("deform", "grid.xyz", "-c", "case.toml", "-m", "tfi", "-o", "plain.xyz", "--force", "-q")[0] == 0
    return read_grid("plain.xyz")


def _contents(folder: Path) -> dict[Path, bytes | None]:
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


KINDS = {"full disk": full_disk}
