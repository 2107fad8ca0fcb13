"""A fuzz campaign: samples by number, each run in a worker process and judged.

``PYTHONPATH=tests python -m fuzz.campaign N --seed S`` runs N samples and prints a table; ``make fuzz N=20000``.
"""

import argparse
import faulthandler
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from random import Random

from . import case_files, grid_files, tables
from .bench import Bench, called

LIMIT = 100.0
"""Seconds that a file of a few kB may take, on a machine that does much else."""
_SLICE = 1000
RIGHT = ("ok", "refused")
KINDS: dict[str, Callable[[Bench, Random], str]] = {**grid_files.KINDS, **tables.KINDS, **case_files.KINDS}

Sample = tuple[int, str, str]
"""Number, class, and result: ``ok`` (accepted, right), ``refused``, or what is wrong."""


def work(first: int, last: int, seed: int) -> None:
    """Run samples in the current folder; prints one JSON line before each, and one with its result."""
    # Loops are compiled here, where no limit of time applies.
    code, told = called("warm-up", "-q")
    assert code == 0, told
    bench = Bench()
    for module in (grid_files, tables, case_files):
        module.prepare(bench)
    bench.keep()
    for number in range(first, last):
        print(json.dumps([number]), flush=True)
        # A hang ends the process: an exception might be taken for an error of the system, or be swallowed.
        faulthandler.dump_traceback_later(LIMIT, exit=True)
        name = [*KINDS][number % len(KINDS)]
        try:
            result = KINDS[name](bench, Random(f"{seed}/{number}"))
        except Exception as error:
            result = f"the judge fails: {type(error).__name__}: {error}"
        print(json.dumps([number, name, result]), flush=True)
    faulthandler.cancel_dump_traceback_later()


def campaign(count: int, seed: int, first: int = 0) -> Iterator[Sample]:
    """Number, class and result of every sample; a worker that dies is a result too."""
    end = first + count
    paths = [str(Path(__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONSAFEPATH": "1", "PYTHONPATH": os.pathsep.join(paths)}
    while first < end:
        with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile("w+") as said:
            command = [sys.executable, "-m", "fuzz.campaign", "--work", str(first), str(end), str(seed)]
            with subprocess.Popen(
                command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=said, text=True
            ) as process:
                for line in process.stdout:
                    entry = json.loads(line)
                    first = entry[0]
                    if len(entry) == 3:
                        yield tuple(entry)
                        first += 1
                ended = process.wait()
            if ended != 0:
                said.seek(0)
                yield first, "worker", f"ended with {ended}: {' | '.join(said.read().splitlines())[:300]}"
                first += 1


def table(samples: list[Sample], seed: int) -> str:
    """Counts of each class, as a table in Markdown."""
    totals = Counter((kind, result if result in RIGHT else "wrong") for _, kind, result in samples)
    words = [*RIGHT, "wrong"]
    lines = [f"| class (seed {seed}) | samples | right | refused | wrong |", "|---" * 5 + "|"]
    for kind in [*sorted({kind for kind, _ in totals}), None]:
        counts = [sum(n for (k, r), n in totals.items() if r == word and kind in (None, k)) for word in words]
        lines.append(f"| {kind or 'all'} | {sum(counts)} | {' | '.join(map(str, counts))} |")
    return "\n".join(lines)


def main() -> int:
    """Run a campaign from the command line, print what is wrong, and its table."""
    if sys.argv[1:2] == ["--work"]:
        work(*(int(word) for word in sys.argv[2:5]))
        return 0
    parser = argparse.ArgumentParser(description="Mutated files and random grids, judged independently.")
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()

    def part(first: int) -> list[Sample]:
        return list(campaign(min(_SLICE, options.count - first), options.seed, first))

    with ThreadPoolExecutor(options.jobs) as pool:
        samples = list(itertools.chain(*pool.map(part, range(0, options.count, _SLICE))))
    wrong = [sample for sample in samples if sample[2] not in RIGHT]
    for number, kind, result in wrong:
        print(f"sample {number} of seed {options.seed} ({kind}): {result}")
    print(table(samples, options.seed))
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
