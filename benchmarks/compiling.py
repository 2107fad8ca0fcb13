"""CPU seconds of a first start, kernel by kernel: everything is compiled into an empty cache.

python benchmarks/compiling.py                     deform -m idw-tfi with fast sums, hemisphere of size 16
python benchmarks/compiling.py --exact -m tfi      other methods, without fast sums
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from tables import MarkdownTable

FAST = '\n[method.idw]\nsummation = "fast"\n\n[method.rbf]\nsummation = "fast"\n'


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-m", "--method", default="idw-tfi", help="method (%(default)s)")
    parser.add_argument("--sample", default="hemisphere", help="sample case (%(default)s)")
    parser.add_argument("--size", default="16", help="its size (%(default)s)")
    parser.add_argument("--exact", action="store_true", help="leave the summation of the case as it is")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # Read by numba when it is imported.
        os.environ["NUMBA_CACHE_DIR"] = str(folder / "cache")
        print(measure(folder, options).markdown(), end="")


def measure(folder: Path, options: argparse.Namespace) -> MarkdownTable:
    """Deform a sample in this process and list what was compiled, the most expensive first."""
    from meshdeform_cli.main import run

    run(["sample", options.sample, "-o", str(folder), "--size", options.size])
    case = folder / "case.toml"
    if not options.exact:
        case.write_text(case.read_text(encoding="utf-8") + FAST, encoding="utf-8")
    start = time.process_time()
    clock = clock_of_kernels()
    job = ["deform", str(folder / "grid.cgns"), "-c", str(case), "-m", options.method, "-o", str(folder / "new.cgns")]
    run([*job, "--time", "2.5e-4", "-q", "--allow-invalid"])
    spent = time.process_time() - start
    table = MarkdownTable(f"Compiling for deform -m {options.method}, {options.sample} {options.size}")
    for name, seconds in clock.seconds.most_common():
        table.rows.append({"function": name, "signatures": clock.signatures[name], "CPU s": seconds})
    own = [name for name in clock.seconds if name.startswith("meshdeform")]
    table.notes = [
        f"{clock.seconds.total():.1f} s of CPU time for {clock.signatures.total()} functions; "
        f"{sum(clock.signatures[name] for name in own)} of them are ours: {sum(clock.seconds[n] for n in own):.1f} s",
        f"the command took {spent:.1f} s of CPU time; what a function calls is counted apart from it",
    ]
    return table


def clock_of_kernels() -> Any:
    """A listener with ``seconds`` of CPU time and ``signatures`` of everything that numba compiles from now on."""
    from numba.core import event

    class Clock(event.Listener):
        def __init__(self) -> None:
            self.seconds: Counter[str] = Counter()
            self.signatures: Counter[str] = Counter()
            # Start time and time spent on called functions, for each function being compiled.
            self._open: list[list[float]] = []

        def on_start(self, event: Any) -> None:
            self._open.append([time.thread_time(), 0.0])

        def on_end(self, event: Any) -> None:
            began, inside = self._open.pop()
            whole = time.thread_time() - began
            function = event.data["dispatcher"].py_func
            name = f"{function.__module__}.{function.__qualname__}"
            self.seconds[name] += whole - inside
            self.signatures[name] += 1
            if self._open:
                self._open[-1][1] += whole

    clock = Clock()
    event.register("numba:compile", clock)
    return clock


if __name__ == "__main__":
    main()
