"""Memory and time of ``deform`` on MPI ranks that act as machines of their own, against one process.

    python benchmarks/ranks.py 12e6 1 4 --limit 900

Each rank has its own temporary folder and its own limit on data (heap and private memory, ``ulimit -d``), and messages
go through TCP only. Rows for 1 rank are those of a process without MPI, which has as many threads as there are ranks at
most.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
from pathlib import Path

from large import write_large
from runs import run
from tables import MarkdownTable, Row

_APART = 'ulimit -d "$0"; export TMPDIR=$(mktemp -d); "$@"; code=$?; rm -r "$TMPDIR"; exit $code'
TCP = ("OMPI_MCA_pml=ob1", "OMPI_MCA_btl=self,tcp", "MPIR_CVAR_NOLOCAL=1", "FI_PROVIDER=tcp")
"""Variables of Open MPI and of MPICH, which ignore each other's."""


def on_ranks(nodes: int, blocks: int, counts: list[int], threads: int, limit: int, method: str) -> MarkdownTable:
    """The same box on each number of ranks; ``limit`` in MiB, 0 for none; ``threads`` of one process."""
    table = MarkdownTable(
        f"Ranks as machines of their own: {method}, {blocks} blocks",
        notes=[
            f"limit on data of every rank: {limit} MiB" if limit else "no limit on data",
            "binary Plot3D, no repair; CPU: of all ranks, start included; peak: resident size of the largest rank",
        ],
    )
    sums = set()
    with tempfile.TemporaryDirectory() as name:
        grid = write_large(Path(name), blocks, nodes)
        for count in counts:
            table.rows.append(_measured(grid, count, threads, limit if count > 1 else 0, method))
            sums.add(hashlib.sha256(grid.with_name("out.p3dbin").read_bytes()).hexdigest())
    first = table.rows[0]
    for row in table.rows:
        row["of the first"], row["wall of the first"] = (
            row["peak MiB"] / first["peak MiB"],
            row["wall s"] / first["wall s"],
        )
    table.notes.append("all files are equal" if len(sums) == 1 else "THE FILES DIFFER")
    return table


def _measured(grid: Path, count: int, threads: int, limit: int, method: str) -> Row:
    folder, report = grid.parent, grid.parent / "report.json"
    launcher = ["env", *TCP, str(Path(sys.executable).with_name("mpiexec")), "--bind-to", "none", "-n", str(count)]
    alone = launcher if count > 1 else []
    apart = ["bash", "-c", _APART, str(limit * 1024)] if limit else []
    command = [
        *alone, *apart, sys.executable, "-m", "meshdeform", "deform", str(grid), "-c", f"{folder}/case.toml", "-m",
        method, "-o", f"{folder}/out.p3dbin", "--report", str(report), "-q", "--force", "--repair", "off",
        "--threads", str(1 if count > 1 else threads),
    ]  # fmt: skip
    wall, usage = run(command)
    facts = json.loads(report.read_text(encoding="utf-8"))
    return {
        "ranks": count,
        "nodes": facts["grid"]["nodes"],
        "peak MiB": facts["peak_memory_bytes"] / 2**20,
        "wall s": wall,
        "CPU s": usage.ru_utime + usage.ru_stime,
    }


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("nodes", type=float, help="of the grid, about")
    parser.add_argument("ranks", type=int, nargs="*", default=[1, 4])
    parser.add_argument("--blocks", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1, help="of one process")
    parser.add_argument("--limit", type=int, default=0, help="MiB of data of every rank")
    parser.add_argument("--method", default="idw-tfi")
    wanted = parser.parse_args()
    table = on_ranks(int(wanted.nodes), wanted.blocks, wanted.ranks, wanted.threads, wanted.limit, wanted.method)
    print(table.markdown())


if __name__ == "__main__":
    main()
