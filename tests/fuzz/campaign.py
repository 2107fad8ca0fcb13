"""A fuzz campaign: samples by number, each run in a worker process and judged.

``PYTHONPATH=tests python -m fuzz.campaign N --seed S`` runs N samples and prints a table; ``make fuzz N=20000``.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

LIMIT = 30.0
"""Seconds that a file of a few kB may take."""
_SLICE = 1000
RIGHT = ("ok", "refused")

Sample = tuple[int, str, str]
"""Number, class, and result: ``ok``, ``refused``, or what is wrong."""


class TooLong(BaseException):
    """The limit of time; no OSError like TimeoutError, which the program would take for the system's refusal."""


def work(first: int, last: int, seed: int) -> None:
    """Run samples and print one JSON line each, and one before each; ends after one that met the limit of time."""
    from .samples import Worker

    worker = Worker(seed)
    # Loops are compiled here, where no limit of time applies.
    worker.warm_up()
    for number in range(first, last):
        print(json.dumps([number]), flush=True)
        entry = [number, *limited(worker.sample, number)]
        print(json.dumps(entry), flush=True)
        # What was broken off may have left anything behind: the next sample gets a process of its own.
        if entry[2].startswith(TooLong.__name__):
            return


def limited(sample: Callable[[int], tuple[str, str]], number: int, limit: float = LIMIT) -> tuple[str, str]:
    """Class and result of a sample that may take so many seconds of processor time."""

    def too_long(number: int, frame: object) -> None:
        raise TooLong(f"more than {limit} s")

    # Processor time, which does not depend on what else the machine does; and for what waits, ten times that. Both
    # clocks strike again, for what swallows an exception; what never returns to Python is ended with its process.
    for clock in (signal.SIGPROF, signal.SIGALRM):
        signal.signal(clock, too_long)
    signal.setitimer(signal.ITIMER_PROF, limit, min(limit, 1.0))
    signal.setitimer(signal.ITIMER_REAL, 10 * limit, min(limit, 1.0))
    faulthandler.dump_traceback_later(20 * limit, exit=True)
    try:
        return sample(number)
    except (Exception, TooLong) as error:
        return "judge", f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        faulthandler.cancel_dump_traceback_later()


def campaign(count: int, seed: int, first: int = 0) -> Iterator[Sample]:
    """Number, class and result of every sample; a worker that dies is a result too."""
    end = first + count
    while first < end:
        with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile("w+") as said:
            command = [sys.executable, "-m", "fuzz.campaign", "--work", str(first), str(end), str(seed)]
            environment = {**os.environ, "PYTHONSAFEPATH": "1"}
            environment["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parents[1]), *_own_path()])
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
                yield first, "worker", f"ended with {ended}: {' | '.join(said.read().splitlines()[-3:])[:300]}"
                first += 1


def _own_path() -> list[str]:
    return [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]


def run(count: int, seed: int, jobs: int) -> list[Sample]:
    """All samples of a campaign, by several workers; what is wrong is printed at once."""

    def one(first: int) -> list[Sample]:
        samples = []
        for sample in campaign(min(_SLICE, count - first), seed, first):
            samples.append(sample)
            if sample[2] not in RIGHT:
                print(f"sample {sample[0]} of seed {seed} ({sample[1]}): {sample[2]}", flush=True)
        return samples

    with ThreadPoolExecutor(jobs) as pool:
        return [sample for part in pool.map(one, range(0, count, _SLICE)) for sample in part]


def table(samples: list[Sample], seed: int) -> str:
    """Counts of each class, as a table in Markdown."""
    totals = Counter((kind, result if result in RIGHT else "wrong") for _, kind, result in samples)
    words = [*RIGHT, "wrong"]
    heads = ["right" if word == "ok" else word for word in words]
    lines = [f"| class (seed {seed}) | samples | {' | '.join(heads)} |", "|---" * (2 + len(words)) + "|"]
    for kind in [*sorted({kind for kind, _ in totals}), None]:
        counts = [sum(n for (k, r), n in totals.items() if r == word and kind in (None, k)) for word in words]
        lines.append(f"| {kind or 'all'} | {sum(counts)} | {' | '.join(map(str, counts))} |")
    return "\n".join(lines)


def main() -> int:
    """Run a campaign from the command line and print its table."""
    if sys.argv[1:2] == ["--work"]:
        work(*(int(word) for word in sys.argv[2:5]))
        return 0
    parser = argparse.ArgumentParser(description="Mutated files and random grids, judged independently.")
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    samples = run(options.count, options.seed, options.jobs)
    print(table(samples, options.seed))
    return int(any(result not in RIGHT for _, _, result in samples))


if __name__ == "__main__":
    sys.exit(main())
