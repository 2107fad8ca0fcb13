"""A cube whose floor rises in a bump, without and with a repair, file to file: processor time, peak and cells.

python benchmarks/bump.py                       65^3 nodes, and 101^3 under a cap of 1 GiB
python benchmarks/bump.py 272 --cap 8GiB        20 million nodes; 1 GB of files
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from runs import run
from tables import MarkdownTable, Row

CASE = """
[[boundary]]
name = "floor"
select = ["block1.kmin"]
kind = "moving"
motion = [{ displace = ["0", "0", "0.35*exp(-((x-0.5)**2+(y-0.5)**2)/0.02)"] }]

[[boundary]]
name = "rest"
select = ["*"]
kind = "fixed"
"""


def write_cube(folder: Path, n: int) -> Path:
    """A cube of side 1 with n^3 nodes as a binary Plot3D file, and its case; all other faces are fixed."""
    file, x = folder / "cube.p3dbin", np.linspace(0.0, 1.0, n)
    with file.open("wb") as out:
        np.array([1, n, n, n], "<i4").tofile(out)
        for plane in (np.tile(x, n), np.repeat(x, n)):
            for _ in range(n):
                plane.astype("<f8").tofile(out)
        for z in x:
            np.full(n * n, z, "<f8").tofile(out)
    (folder / "case.toml").write_text(CASE, encoding="utf-8")
    return file


def measured(n: int, cap: str | None, mode: str, folder: Path) -> Row:
    """One run, which must end with exit code 0 if it repairs."""
    grid, report = write_cube(folder, n), folder / "report.json"
    command = [
        sys.executable, "-m", "meshdeform", "deform", str(grid), "-c", f"{folder}/case.toml", "-o",
        f"{folder}/out.p3dbin", "--report", str(report), "-q", "--force", "--threads", "2", "--repair", mode,
    ]  # fmt: skip
    allowed = ["--allow-invalid"] if mode == "off" else []
    wall, usage = run([*command, *allowed, *(["--max-memory", cap] if cap else [])])
    facts = json.loads(report.read_text(encoding="utf-8"))
    after, done = facts["quality"]["after"], facts["repair"] or {}
    return {
        "nodes": facts["grid"]["nodes"],
        "cap": cap or "none",
        "repair": mode,
        "wall s": wall,
        "CPU s": usage.ru_utime + usage.ru_stime,
        "peak MiB": usage.ru_maxrss / 1024,
        "min scaled Jacobian": after["min_scaled_jacobian"],
        "Newton steps": done.get("newton_steps", 0),
        "nodes moved": done.get("nodes", 0),
        "left out": done.get("left_out") or "",
    }


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("n", type=int, nargs="*", help="nodes along an edge")
    parser.add_argument("--cap", help="--max-memory")
    parser.add_argument("--folder", type=Path, help="for the files, 48 bytes per node and as much to work in")
    options = parser.parse_args()
    sizes = [(n, options.cap) for n in options.n] or [(65, None), (101, "1GiB")]
    table = MarkdownTable("A bump in a cube, idw-tfi")
    for n, cap in sizes:
        for mode in ("off", "auto"):
            with tempfile.TemporaryDirectory(dir=options.folder) as name:
                table.rows.append(measured(n, cap, mode, Path(name)))
    print(table.markdown())


if __name__ == "__main__":
    main()
