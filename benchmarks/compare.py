"""Compare two installations of meshdeform, file to file, in one run: nothing should become slower.

    python benchmarks/compare.py OTHER/bin/python
    python benchmarks/compare.py OTHER/bin/python --samples splitter-plate-16 --methods tfi idw-tfi --repeats 5

``OTHER`` is the environment of the other version, which may be as old as 0.1. Every command is run by both in turns,
with the default options of each; the table gives the smallest CPU times (user and system, all threads) of a whole
``deform`` and of a further level of ``series``, which is the difference between a long and a short series.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from cases import TIMES
from runs import run
from tables import MarkdownTable, Row

METHODS = ("tfi", "idw", "rbf", "idw-tfi", "rbf-tfi", "idw-rbf")
SAMPLES = ("hemisphere-48", "splitter-plate-16")
_SHORT, _LONG = 3, 9


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", type=Path, help="python of the other version's environment")
    parser.add_argument("--samples", nargs="+", default=SAMPLES, metavar="NAME-SIZE")
    parser.add_argument("--methods", nargs="+", default=METHODS)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    programs = {"other": _Program(options.other), "this": _Program(Path(sys.executable))}
    table = MarkdownTable("CPU seconds, all threads, of another version and of this one")
    with tempfile.TemporaryDirectory() as name:
        for sample in options.samples:
            folder = _sample(Path(name), sample)
            for method in options.methods:
                table.rows.append({"case": sample, "method": method, **_row(programs, folder, method, options.repeats)})
                print(table.rows[-1], file=sys.stderr, flush=True)
    print(table.markdown())


class _Program:
    """The command of an environment."""

    def __init__(self, python: Path):
        self._command = str(python.parent / "meshdeform")
        told = subprocess.run([self._command, "deform", "--help"], capture_output=True, text=True, check=True).stdout
        # Version 0.1 cannot repair.
        self._always = ["--allow-invalid", "--force", "-q", *(["--repair", "off"] if "--repair" in told else [])]

    def cpu(self, folder: Path, method: str, command: Sequence[str]) -> float:
        """CPU seconds of a command on a sample."""
        name, *options = command
        inputs = [str(folder / "grid.cgns"), "-c", str(folder / "case.toml"), "-m", method]
        usage: resource.struct_rusage
        _, usage = run([self._command, name, *inputs, *options, *self._always])
        return usage.ru_utime + usage.ru_stime


def _sample(folder: Path, label: str) -> Path:
    """Grid and case of a sample whose motion depends on the time."""
    sample, _, size = label.rpartition("-")
    target = folder / label
    run([sys.executable, "-m", "meshdeform", "sample", sample, "-o", str(target), "--size", size])
    case = target / "case.toml"
    text = case.read_text(encoding="utf-8")
    if sample not in TIMES:
        # Rotations of different angles: no level is a combination of others for methods that turn cells.
        text = text.replace('angle = "angle"', 'angle = "angle*t"')
    else:
        text = text.replace("2*pi*frequency*t", "0.5*pi*t").replace("frequency = 1e3\n", "")
    case.write_text(text, encoding="utf-8")
    return target


def _row(programs: dict[str, _Program], folder: Path, method: str, repeats: int) -> Row:
    """Smallest CPU seconds of both versions, and their ratios."""
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in programs}
    series = ["series", "-o", str(folder / "out"), "--suffix", ".xyz"]
    for program in programs.values():
        # Loops are compiled at their first use.
        program.cpu(folder, method, [*series, f"--times={_times(2)}"])
    for _ in range(repeats):
        for name, program in programs.items():
            deform = program.cpu(folder, method, ["deform", "-o", str(folder / "out.xyz"), "--time", "1"])
            short, long = (
                program.cpu(folder, method, [*series, f"--times={_times(count)}"]) for count in (_SHORT, _LONG)
            )
            found[name].append((deform, (long - short) / (_LONG - _SHORT)))
    best = {name: [min(column) for column in zip(*rows, strict=True)] for name, rows in found.items()}
    row: Row = {}
    for place, what in enumerate(("deform", "level")):
        other, this = best["other"][place], best["this"][place]
        row |= {f"{what}, other": other, f"{what}, this": this, f"{what}, ratio": this / other}
    return row


def _times(count: int) -> str:
    """Times of a series, rising from -1 by steps that make no level a repetition of another.

    The displacement shrinks: what is done anew whenever the motion grows counts for the first level.
    """
    return ",".join(f"{0.03 * n - 1.0:.2f}" for n in range(count))


if __name__ == "__main__":
    main()
