"""Memory of whole runs over ranks: the total on the machine, with shared pages counted once.

    python benchmarks/rank_memory.py 24 idw-tfi         # or: idw; a third argument is the suffix of the grid

The resident size of a process counts the pages that it shares with others in full. The proportional set size (PSS)
divides each page among the processes that share it: the sum over the ranks is the machine's total. Ranks "apart" act
as machines of their own, which share nothing. Linux only.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from runs import make_sample
from tables import MarkdownTable

COUNTS = (1, 2, 4)
PERIOD = 0.02
APART = "apart"


def main(size, method, suffix=".cgns"):
    table = MarkdownTable(f"Splitter plate n = {size} ({suffix}), {method}: one thread per rank")
    with tempfile.TemporaryDirectory() as name:
        folder = make_sample(Path(name), "splitter-plate", size, suffix)
        arguments = [
            "deform", f"{folder}/grid{suffix}", "-c", f"{folder}/case.toml",
            "-m", method, "-o", f"{folder}/deformed{suffix}", "--force", "--allow-invalid", "-q", "--threads", "1",
            "--repair", "off",
        ]  # fmt: skip
        for count in COUNTS:
            for apart in (False, True)[: min(count, 2)]:
                program = [sys.executable, *([__file__, APART] if apart else ["-m", "meshdeform"])]
                found = measure(["mpiexec", "--oversubscribe", "-n", str(count), *program, *arguments])
                table.rows.append({"ranks": f"{count} apart" if apart else count, **found})
    print(table.markdown())


def measure(command):
    """Wall and CPU seconds of a command on ranks, largest PSS of one of them and of all together."""
    start, largest, total = time.perf_counter(), 0.0, 0.0
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    while True:
        done, status, usage = os.wait4(process.pid, os.WNOHANG)
        if done:
            break
        sizes = [_pss(pid) for pid in _descendants(process.pid)]
        largest, total = max([largest, *sizes]), max(total, sum(sizes))
        time.sleep(PERIOD)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{' '.join(command)} ended with exit code {process.returncode}")
    wall, cpu = time.perf_counter() - start, usage.ru_utime + usage.ru_stime
    return {"wall s": wall, "CPU s": cpu, "largest rank MB": largest, "all ranks MB": total}


def _descendants(pid):
    try:
        children = [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []
    return [each for child in children for each in (child, *_descendants(child))]


def _pss(pid):
    """Proportional set size in MB; 0 for a process that has ended."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0.0
    return sum(int(line.split()[1]) * 1024e-6 for line in lines if line.startswith("Pss:"))


def run_apart(arguments):
    """The command on ranks of this machine that share no memory with each other."""
    from meshdeform_cli.main import main as command
    from meshdeform_core.parallel import mpi

    made = mpi.MPIRanks
    mpi.MPIRanks = lambda world: made(world, machines=world.size)
    sys.argv[1:] = arguments
    command()


if sys.argv[1] == APART:
    run_apart(sys.argv[2:])
else:
    main(int(sys.argv[1]), *sys.argv[2:])
