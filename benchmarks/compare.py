"""Compare two installations of meshdeform, file to file, in one run: nothing should become slower.

    python benchmarks/compare.py OTHER/bin/python
    python benchmarks/compare.py OTHER/bin/python --samples splitter-plate-16 --methods tfi idw-tfi --repeats 5

``OTHER`` is the environment of the other version. Every command is run by both in turns; the table gives the smallest
CPU times (user and system, all threads) of a whole ``deform`` and of a further level of ``series``, which is the
difference between a long and a short series.
"""

from __future__ import annotations

import argparse
import resource
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
    pythons = {"other": str(options.other), "this": sys.executable}
    table = MarkdownTable("CPU seconds, all threads, of another version and of this one")
    with tempfile.TemporaryDirectory() as name:
        for sample in options.samples:
            folder = _sample(Path(name), sample)
            for method in options.methods:
                table.rows.append({"case": sample, "method": method, **_row(pythons, folder, method, options.repeats)})
                print(table.rows[-1], file=sys.stderr, flush=True)
    print(table.markdown())


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


def _row(pythons: dict[str, str], folder: Path, method: str, repeats: int) -> Row:
    """Smallest CPU seconds of both versions, and their ratios."""
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in pythons}
    for _ in range(1 + repeats):
        for name, python in pythons.items():
            deform = _cpu(python, folder, method, ["deform", "-o", str(folder / "out.xyz"), "--time", "1"])
            series = [
                _cpu(
                    python, folder, method, ["series", "-o", str(folder / "out"), "--suffix", ".xyz", "--times", times]
                )
                for times in (_times(_SHORT), _times(_LONG))
            ]
            found[name].append((deform, (series[1] - series[0]) / (_LONG - _SHORT)))
    # The first round compiles.
    best = {name: [min(column) for column in zip(*rows[1:], strict=True)] for name, rows in found.items()}
    row: Row = {}
    for place, what in enumerate(("deform", "level")):
        other, this = best["other"][place], best["this"][place]
        row |= {f"{what}, other": other, f"{what}, this": this, f"{what}, ratio": this / other}
    return row


def _times(count: int) -> str:
    """Times of a series, falling from 1 by steps that make no level a repetition of another."""
    return ",".join(f"{1.0 - 0.03 * n:.2f}" for n in reversed(range(count)))


def _cpu(python: str, folder: Path, method: str, command: Sequence[str]) -> float:
    name, *options = command
    arguments = [name, str(folder / "grid.cgns"), "-c", str(folder / "case.toml"), "-m", method, *options]
    usage: resource.struct_rusage
    _, usage = run([python, "-m", "meshdeform", *arguments, "--repair", "off", "--allow-invalid", "--force", "-q"])
    return usage.ru_utime + usage.ru_stime


if __name__ == "__main__":
    main()
