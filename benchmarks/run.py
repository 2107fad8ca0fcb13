"""Measure speed and memory of meshdeform in one run on one machine.

python benchmarks/run.py                                  tables on stdout
python benchmarks/run.py --quick --only idw
python benchmarks/run.py --write benchmarks/RESULTS.md      and into the page, between its marks
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

import blocks
import derivatives
import idw
import levels
import machine
import passes
import rbf
import runs
from tables import MarkdownTable

SECTIONS: dict[str, tuple[Callable[[bool], MarkdownTable], ...]] = {
    "machine": (lambda quick: machine.description(), lambda quick: machine.limits()),
    "loop": (idw.exact_loop,),
    "idw": (idw.fast_against_exact, idw.processor_time),
    "threads": (idw.threads,),
    "rbf": (rbf.against_scipy, rbf.large_systems, rbf.compact_bases),
    "passes": (passes.memory_speed,),
    "levels": (levels.of_every_method, levels.hundred_levels),
    "derivatives": (derivatives.in_applications, derivatives.beside_jax),
    "runs": (runs.file_to_file, runs.with_threads),
    "blocks": (blocks.by_blocks,),
    "ranks": (runs.ranks,),
    "start": (runs.start_up,),
}
"""What ``--only`` accepts; the names of the marks in the page."""


def measure(names: list[str], quick: bool) -> tuple[dict[str, list[MarkdownTable]], MarkdownTable]:
    """The tables of the named sections, printed as they are finished, and how long each took."""
    results: dict[str, list[MarkdownTable]] = {}
    times = MarkdownTable("Time of each table")
    for name in names:
        results[name] = []
        for section in SECTIONS[name]:
            start, cpu = time.perf_counter(), _cpu_seconds()
            table = section(quick)
            results[name].append(table)
            print(table.markdown(), flush=True)
            times.rows.append({"section": name, "table": table.title, "wall s": time.perf_counter() - start})
            times.rows[-1]["CPU s"] = _cpu_seconds() - cpu
            print(f"{name}: {table.title}: {times.rows[-1]['wall s']:.0f} s", file=sys.stderr, flush=True)
    total = {what: sum(row[what] for row in times.rows) for what in ("wall s", "CPU s")}
    times.rows.append({"section": "all", "table": "", **total})
    return results, times


def _cpu_seconds() -> float:
    """Processor time of this process and of the commands that it has run."""
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def renewed(page: str, results: dict[str, list[MarkdownTable]]) -> str:
    """The page with the tables of the measured sections, with today's date, in place of what its marks enclose."""
    for name, tables in results.items():
        begin, end = f"<!-- run.py {name} begin -->\n", f"<!-- run.py {name} end -->"
        if begin in page:
            before, rest = page.split(begin)
            texts = [*(table.markdown() for table in tables), f"*Measured on {time.strftime('%Y-%m-%d')}.*\n"]
            page = before + begin + "\n".join(texts) + end + rest.split(end)[1]
    return page


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small sizes: under two minutes")
    parser.add_argument("--only", action="append", choices=SECTIONS, metavar="NAME", help=f"{', '.join(SECTIONS)}")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the tables as JSON")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="renew the tables of the page")
    options = parser.parse_args()
    if options.quick and options.write:
        parser.error("the page has no tables of small sizes")
    results, times = measure(options.only or list(SECTIONS), options.quick)
    print(times.markdown())
    if options.json:
        record = {name: [table.as_json() for table in tables] for name, tables in results.items()}
        options.json.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    if options.write:
        page = options.write.read_text(encoding="utf-8")
        options.write.write_text(renewed(page, results), encoding="utf-8")


if __name__ == "__main__":
    main()
