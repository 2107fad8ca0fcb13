"""Whole runs of the command, file to file: time by stage, peak memory, ranks."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import os
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from cases import TIMES
from tables import MarkdownTable, Row

STAGES = ("read", "topology", "prepare", "apply", "quality", "write")
RUNS = (
    ("splitter-plate", 16, "idw-tfi"), ("splitter-plate", 32, "idw-tfi"), ("splitter-plate", 32, "idw"),
    ("hemisphere", 92, "idw-tfi"), ("hemisphere", 92, "idw"), ("hemisphere", 152, "idw-tfi"),
)  # fmt: skip
QUICK = (("splitter-plate", 8, "idw-tfi"), ("splitter-plate", 8, "idw"))
_COMMAND = (sys.executable, "-m", "meshdeform")
# Open MPI refuses root, which containers often are, and more ranks than cores unless told.
_LENIENT = dict.fromkeys(
    (
        "OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "PRTE_ALLOW_RUN_AS_ROOT",
        "PRTE_ALLOW_RUN_AS_ROOT_CONFIRM", "OMPI_MCA_rmaps_base_oversubscribe",
    ),
    "1",
) | {"PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe"}  # fmt: skip
_COUNT_RANKS = "from mpi4py import MPI; print(MPI.COMM_WORLD.size)"


def file_to_file(quick: bool) -> MarkdownTable:
    """``meshdeform deform`` with quality and report: wall, CPU, stages, peak memory in coordinate arrays."""
    table = MarkdownTable(
        "Whole runs, file to file",
        notes=[
            "wall and CPU: the whole process, start of Python included; stages: as in its report, seconds",
            "peak: largest resident size; as coordinate arrays: less that of the same command on 4,000 nodes, divided "
            "by 24 bytes per node",
        ],
    )
    with tempfile.TemporaryDirectory() as folder:
        small = make_sample(Path(folder), "hemisphere", 8)
        for sample, size, method in QUICK if quick else RUNS:
            base = _deform(small, "hemisphere", method)["peak MB"]
            row = _deform(make_sample(Path(folder), sample, size), sample, method)
            row["peak, coordinate arrays"] = (row["peak MB"] - base) / (24e-6 * row["nodes"])
            table.rows.append({"case": f"{sample} {size}", "method": method, **row})
    return table


def with_threads(quick: bool) -> MarkdownTable:
    """The whole command with one thread and with two."""
    table = MarkdownTable(
        "Whole runs with one thread and with two",
        notes=[
            "wall times, reading and writing included; the better of two runs each",
            "start: `meshdeform deform --dry-run` on a small grid, which no thread makes faster",
        ],
    )
    sample, size = ("hemisphere", 24) if quick else ("hemisphere", 92)
    with tempfile.TemporaryDirectory() as name:
        folder, small = make_sample(Path(name), sample, size), make_sample(Path(name), "hemisphere", 8)
        for method in ("tfi", "idw-tfi", "idw"):
            start = _best_wall(small, "hemisphere", method, 2, "--dry-run")
            one, two = (_best_wall(folder, sample, method, threads) for threads in (1, 2))
            table.rows.append(
                {"case": f"{sample} {size}", "method": method, "start s": start, "1 thread s": one,
                 "2 threads s": two, "ratio": one / two}
            )  # fmt: skip
    return table


def _best_wall(folder: Path, sample: str, method: str, threads: int, *more: str) -> float:
    command = [
        *_COMMAND, "deform", f"{folder}/grid.cgns", "-c", f"{folder}/case.toml", "-m", method, "-o",
        f"{folder}/deformed.cgns", "--time", str(TIMES.get(sample, 0.0)), "--threads", str(threads), "--force",
        "--allow-invalid", "-q", *more,
    ]  # fmt: skip
    return min(run(command)[0] for _ in range(2))


def start_up(quick: bool) -> MarkdownTable:
    """Commands on a small grid after their first start: mostly imports."""
    table = MarkdownTable(
        "Start-up, hemisphere 16 (28,152 nodes)",
        notes=[
            "best of several runs of each command, all output discarded",
            "imports: the sum that `python -X importtime` gives, which itself takes a part of it",
        ],
    )
    with tempfile.TemporaryDirectory() as name:
        folder = make_sample(Path(name), "hemisphere", 16)
        grid, case, output = (str(folder / file) for file in ("grid.cgns", "case.toml", "deformed.cgns"))
        job = ["deform", grid, "-c", case, "-o", output, "--time", "3", "--force", "-m"]
        commands = {"--help": ["--help"], "info grid.cgns": ["info", grid]}
        commands |= {f"deform -m {method}": [*job, method] for method in ("idw-tfi", "idw", "tfi", "rbf")}
        for title, arguments in commands.items():
            run([*_COMMAND, *arguments])
            runs = [run([*_COMMAND, *arguments]) for _ in range(3 if quick else 5)]
            wall, usage = min(runs, key=lambda each: each[0])
            table.rows.append(
                {
                    "command": f"`meshdeform {title}`",
                    "wall s": wall,
                    "CPU s": usage.ru_utime + usage.ru_stime,
                    "imports s": min(_import_seconds(arguments) for _ in range(3)),
                }
            )
    return table


def _import_seconds(arguments: Sequence[str]) -> float:
    command = [sys.executable, "-X", "importtime", *_COMMAND[1:], *arguments]
    told = subprocess.run(command, check=True, capture_output=True, text=True, env=_environment()).stderr
    lines = (line for line in told.splitlines() if line.startswith("import time:") and "self" not in line)
    return sum(int(line.removeprefix("import time:").split("|")[0]) for line in lines) / 1e6


def make_sample(folder: Path, sample: str, size: int) -> Path:
    """Grid and case of a sample in a separate folder."""
    target = folder / f"{sample}-{size}"
    if not target.exists():
        run([*_COMMAND, "sample", sample, "-o", str(target), "--size", str(size)])
    return target


def _deform(folder: Path, sample: str, method: str, launcher: Sequence[str] = ()) -> Row:
    report = folder / "report.json"
    wall, usage = run(
        [
            *launcher, *_COMMAND, "deform", f"{folder}/grid.cgns", "-c", f"{folder}/case.toml", "-m", method,
            "-o", f"{folder}/deformed.cgns", "--time", str(TIMES.get(sample, 0.0)), "--report", str(report),
            "--force", "--allow-invalid", "-q",
        ]
    )  # fmt: skip
    facts = json.loads(report.read_text(encoding="utf-8"))
    return {
        "nodes": facts["grid"]["nodes"],
        "wall s": wall,
        "CPU s": usage.ru_utime + usage.ru_stime,
        **{stage: facts["timing"][stage] for stage in STAGES},
        "peak MB": facts["peak_memory_bytes"] / 1e6,
    }


def run(command: Sequence[str]) -> tuple[float, resource.struct_rusage]:
    """Wall seconds and resources of a process with its children.

    Raises
    ------
    RuntimeError
        When it fails.
    """
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=_environment())
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{' '.join(command)} ended with exit code {process.returncode}")
    return time.perf_counter() - start, usage


def _environment() -> dict[str, str]:
    """As in an installation, modules are loaded from bytecode."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return environment | _LENIENT


def ranks(quick: bool) -> MarkdownTable:
    """Strong scaling of one run over MPI ranks, one thread each."""
    table = MarkdownTable("MPI ranks: the same run on more of them, one thread per rank")
    launcher, missing = _launcher()
    if missing:
        table.notes.append(f"not measured: {missing}")
        return table
    table.notes.append(f"started by {' '.join([Path(launcher[0]).name, *launcher[1:]])}")
    sample, size = ("splitter-plate", 8) if quick else ("splitter-plate", 32)
    with tempfile.TemporaryDirectory() as name:
        folder = make_sample(Path(name), sample, size)
        for method in ("idw-tfi", "idw"):
            one = 0.0
            for count in (1, 2, 4):
                row = _deform(folder, sample, method, [*launcher, "-n", str(count)])
                one = one or row["wall s"]
                table.rows.append(
                    {"case": f"{sample} {size}", "method": method, "ranks": count, "wall s": row["wall s"],
                     "speed-up": one / row["wall s"], "cores": os.cpu_count()}
                )  # fmt: skip
    return table


def _launcher() -> tuple[list[str], str]:
    """The command that starts ranks, or why there is none.

    The environment variable MPIEXEC, else the ``mpiexec`` beside this Python, else that of the system: the first that
    starts two ranks of the library that mpi4py uses.
    """
    if "mpi" not in (importlib.metadata.metadata("meshdeform").get_all("Provides-Extra") or []):
        return [], "this version has no extra [mpi]"
    if importlib.util.find_spec("mpi4py") is None:
        return [], "mpi4py is not installed"
    beside, on_path = Path(sys.executable).with_name("mpiexec"), shutil.which("mpiexec")
    found = [str(beside)] * beside.exists() + [on_path] * (on_path is not None)
    known = [shlex.split(os.environ["MPIEXEC"])] if os.environ.get("MPIEXEC") else [[each] for each in found]
    told = "there is no mpiexec; MPIEXEC may name one"
    for launcher in known:
        trial = [*launcher, "-n", "2", sys.executable, "-c", _COUNT_RANKS]
        done = subprocess.run(trial, capture_output=True, text=True, timeout=60, check=False, env=_environment())
        if done.stdout.split() == ["2", "2"]:
            return launcher, ""
        told = f"{launcher[0]} does not start two ranks of mpi4py's library here (exit code {done.returncode})"
    return [], told
