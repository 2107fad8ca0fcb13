"""Classes of runs within limits: a full disk, little memory, several processes."""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from random import Random

import numpy as np
from grids import CASE, frame

from meshdeform_core.grid import Grid
from meshdeform_formats import read_grid, write_grid

from .bench import METHODS, Bench, called, refusal
from .mutations import mutated

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


_SIZES = (
    "0", "-1GiB", "1", "1e9", "4 GB", "240MiB", "241.5MiB", "300MiB", " 2GiB ", "2GiBB", "GiB", "", "9" * 400,
    "9" * 400 + "GiB", "\uff12GiB", "0.0000001B", "nan", "inf", "1.GiB", "1TiB", "99999999999TiB", "2**40", "1,5GiB",
    "0x10", "1_000MB", "220.3MiB",
)  # fmt: skip


def memory_limit(bench: Bench, rng: Random) -> str:
    """Under any limit the result is that without one, or there is none."""
    method = rng.choice(METHODS)
    plain = _without_limit(method)
    size = rng.choice(_SIZES) if rng.random() < 0.7 else f"{rng.uniform(215, 230):.4f}MiB"
    arguments = ("deform", "grid.xyz", "-c", "case.toml", "-m", method, "-o", "out.xyz", "--force", "-q")
    code, told = called(*arguments, "--max-memory", size)
    if code != 0:
        return refusal(code, told)
    worst = np.abs(read_grid("out.xyz").points - plain).max()
    return "ok" if worst <= 1e-9 else f"with --max-memory {size} {method} differs by {worst}"


@functools.cache
def _without_limit(method: str) -> np.ndarray:
    assert called("deform", "grid.xyz", "-c", "case.toml", "-m", method, "-o", "plain.xyz", "--force", "-q")[0] == 0
    return read_grid("plain.xyz").points


_MEASURED = """
import resource, subprocess, sys
code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
sys.exit(code)
"""


def memory_peak(bench: Bench, rng: Random) -> str:
    """A process of its own keeps to its limit, as the system measures it, or refuses."""
    if resource is None or sys.platform != "linux":
        return NO_SUCH
    if not Path("large.xyz").exists():
        write_grid(frame(24, 12), "large.xyz")
    limit, method = rng.uniform(215, 420), rng.choice(("tfi", "idw-tfi", "rbf-tfi"))
    command = [sys.executable, "-m", "meshdeform_cli", "deform", "large.xyz", "-c", "case.toml", "-m", method, "-q"]
    command += ["-o", "large_out.xyz", "--force", "--max-memory", f"{limit:.3f}MiB", "--repair", "off"]
    # A small process starts it: the system counts what the process was that became it.
    done = subprocess.run([sys.executable, "-c", _MEASURED, *command], capture_output=True, text=True, check=False)
    code, peak = done.returncode, int(done.stdout) / 1024
    if code in (0, 3):
        return "ok" if peak <= limit else f"{peak:.1f} MiB under a limit of {limit:.1f} MiB ({method})"
    return refusal(code, done.stderr)


# --- several ranks --------------------------------------------------------------------------------------------------

LENIENT = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "OMPI_MCA_mpi_yield_when_idle": "1",
    "OPENBLAS_NUM_THREADS": "1",
}


def two_ranks(bench: Bench, rng: Random) -> str:
    """Two processes do what one does, with good files and with damaged ones."""
    if MPIEXEC is None or importlib.util.find_spec("mpi4py") is None:
        return NO_SUCH
    name, text = rng.choice((("grid.xyz", False), ("grid.p3dfmt", True), ("grid.cgns", False), ("set.vtm", True)))
    bad = Path(f"ranks{Path(name).suffix}")
    data = bench.valid[name]
    bad.write_bytes(mutated(data, text, rng) if rng.random() < 0.5 else data)
    Path("ranks.toml").write_text(CASE if rng.random() < 0.7 else "")
    case = Path("ranks.toml").read_bytes() or mutated(CASE.encode(), True, rng)
    Path("ranks.toml").write_bytes(case)
    arguments = ("deform", str(bad), "-c", "ranks.toml", "-m", rng.choice(METHODS), "--force", "-q")
    alone, told = called(*arguments, "-o", "alone.xyz")
    command = [MPIEXEC, "-n", "2", sys.executable, "-m", "meshdeform_cli", *arguments, "-o", "shared.xyz"]
    try:
        done = subprocess.run(
            command, env={**os.environ, **LENIENT}, capture_output=True, text=True, timeout=120, check=False
        )
    except subprocess.TimeoutExpired:
        return "two ranks have not ended in 120 s"
    if done.returncode != alone:
        return f"two ranks end with {done.returncode}, one with {alone}: {done.stderr[-200:]} | {told[-100:]}"
    if alone != 0:
        return "ok" if alone == 3 else refusal(alone, told if done.stderr.count("error: ") == 1 else done.stderr)
    worst = np.abs(read_grid("shared.xyz").points - read_grid("alone.xyz").points).max()
    return "ok" if worst < 1e-12 else f"two ranks differ by {worst} from one"


KINDS = {"full disk": full_disk, "memory limit": memory_limit}
RARE = {"two ranks": two_ranks, "memory peak": memory_peak}
