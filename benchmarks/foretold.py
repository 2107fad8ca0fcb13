"""What dry runs foretell of memory, and the largest resident size of the runs.

python benchmarks/foretold.py                                   a table of runs, 20 minutes
python benchmarks/foretold.py 6e7 10 p3dbin idw-tfi --cap 2GiB  one of them
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from large import write_large
from runs import run
from tables import MarkdownTable, Row

RUNS = (
    *((3e5, 1, "p3dbin", method, None) for method in ("tfi", "idw", "idw-tfi", "rbf", "rbf-tfi")),
    (7e5, 1000, "p3dbin", "idw-tfi", None), (2e6, 1, "p3dbin", "tfi", None), (2e6, 1, "cgns", "tfi", None),
    (2e6, 1000, "p3dbin", "idw", None), (2e6, 1000, "cgns", "tfi", None), (5e6, 10, "cgns", "idw-tfi", None),
    (5e6, 1, "p3dbin", "rbf-tfi", None), (2e7, 1, "p3dbin", "tfi", None), (2e7, 10, "p3dbin", "idw-tfi", None),
    (2e7, 1000, "p3dbin", "idw-tfi", None), (2e7, 1, "p3dbin", "idw-tfi", "1GiB"),
    (6e7, 10, "p3dbin", "idw-tfi", "2GiB"),
)  # fmt: skip
_FORETELL = "from meshdeform_cli import dry_run, main; dry_run.TRIAL_NODES = 0; sys.exit(main.run(sys.argv[1:]))"
"""Also of grids that are small enough for a trial."""


def foretold(nodes: float, blocks: int, suffix: str, method: str, cap: str | None, parent: Path | None) -> Row:
    """One run without a repair, on two threads."""
    with tempfile.TemporaryDirectory(dir=parent) as name:
        grid, meshdeform = write_large(Path(name), blocks, int(nodes)), [sys.executable, "-m", "meshdeform"]
        if suffix != "p3dbin":
            run([*meshdeform, "convert", str(grid), f"{name}/grid.{suffix}", "-q"])
            grid = grid.with_suffix(f".{suffix}")
        options = [
            "deform", str(grid), "-c", f"{name}/case.toml", "-m", method, "-o", f"{name}/out.{suffix}", "-q",
            "--threads", "2", "--repair", "off", *(["--max-memory", cap] if cap else []),
        ]  # fmt: skip
        dry = [sys.executable, "-c", f"import sys; {_FORETELL}", *options, "--dry-run", "--json"]
        plan = json.loads(subprocess.run(dry, check=True, capture_output=True).stdout)
        expected, (_, usage) = plan["expected"]["memory_bytes"] / 1e6, run([*meshdeform, *options])
    peak = usage.ru_maxrss * 1024e-6
    return {
        "nodes": plan["grid"]["nodes"], "blocks": blocks, "format": suffix, "method": method, "limit": cap or "none",
        "foretold MB": expected, "peak MB": peak, "deviation %": 100 * (expected / peak - 1),
    }  # fmt: skip


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("one", nargs="*", metavar="NODES BLOCKS FORMAT METHOD", help="one run instead of the table")
    parser.add_argument("--cap", help="--max-memory of the run")
    parser.add_argument("--folder", type=Path, help="for the files, up to 100 bytes per node")
    given = parser.parse_args()
    runs = [(float(given.one[0]), int(given.one[1]), *given.one[2:], given.cap)] if given.one else RUNS
    table = MarkdownTable("Memory, foretold and taken", [foretold(*each, given.folder) for each in runs])
    table.notes.append("boxes of large.py without a repair, loops compiled before; peak: largest resident size")
    print(table.markdown())


if __name__ == "__main__":
    main()
