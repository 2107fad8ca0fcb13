"""Classes of other commands: repairs, and commands that only look."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random

import numpy as np
from grids import CASE

from meshdeform_formats import read_grid, write_grid

from . import judges
from .bench import Bench, called, refusal, spoken
from .mutations import mutated

FOLDED = CASE.replace("turn = 10.0", "turn = 70.0")


def prepare(bench: Bench) -> None:
    """A grid with invalid cells, as another program might make it."""
    Path("folded.toml").write_text(FOLDED)
    arguments = ("deform", "grid.xyz", "-c", "folded.toml", "-m", "tfi", "--repair", "off", "--steps", "1", "-q")
    assert called(*arguments, "--allow-invalid", "-o", "folded.xyz")[0] == 0
    write_grid(read_grid("folded.xyz"), "folded.fmt", {"encoding": "ascii"})


# --- repair ---------------------------------------------------------------------------------------------------------


def repair(bench: Bench, rng: Random) -> str:
    """A folded grid is repaired by a reference, one of the two perhaps damaged; outside faces stay."""
    Path("bad.fmt").write_bytes(bench.valid["folded.fmt"])
    Path("reference.fmt").write_bytes(bench.valid["grid.p3dfmt"])
    for name in rng.choice(((), ("bad.fmt",), ("reference.fmt",), ("bad.fmt", "reference.fmt"))):
        Path(name).write_bytes(mutated(Path(name).read_bytes(), True, rng))
    more = rng.choice(
        ((), ("--polish",), ("-c", "folded.toml"), ("--min-jacobian", rng.choice(("0.2", "-1", "nan", "9"))))
    )
    code, told = called("repair", "bad.fmt", "--reference", "reference.fmt", "-o", "mended.xyz", "--force", "-q", *more)
    if code != 0:
        return "ok" if code == 3 else refusal(code, told)
    before, bent, after = (read_grid(name) for name in ("reference.fmt", "bad.fmt", "mended.xyz"))
    for name, grid in (("reference.fmt", before), ("bad.fmt", bent)):
        if wrong := judges.plot3d_text(Path(name), grid):
            return f"{name}: {wrong}"
    bad = judges.newly_bad(before, after)
    if bad:
        return f"{bad} cells are invalid and the exit code is 0"
    # A damaged reference may have an inner node where the body is.
    whole = read_grid("grid.xyz").points
    outside = np.abs((whole if whole.shape == before.points.shape else before.points)[:, :2]).max(axis=1)
    still = (np.abs(outside - 2.0) < 1e-9) | (outside < 0.51)
    return "ok" if np.abs(after.points - bent.points)[still].max() < 1e-9 else "the boundary has moved"


# --- looking --------------------------------------------------------------------------------------------------------


def looks(bench: Bench, rng: Random) -> str:
    """Commands that only look: what they print is JSON without NaN and holds for the grid that was read."""
    name, text = rng.choice((("grid.xyz", False), ("grid.p3dfmt", True), ("grid.cgns", False), ("grid.vts", True)))
    bad = Path(f"bad{Path(name).suffix}")
    bad.write_bytes(mutated(bench.valid[name], text, rng) if rng.random() < 0.8 else bench.valid[name])
    command = rng.choice(("info", "quality", "reference", "compare", "init", "deform"))
    if command == "init":
        code, told = called("init", str(bad), "-o", "new.toml", "--force")
        if code == 0:
            code, told = called("deform", str(bad), "-c", "new.toml", "--dry-run", "-q")
        return "ok" if code == 0 else refusal(code, told)
    arguments = {
        "info": ("info", str(bad), "--json"),
        "quality": ("quality", str(bad), "--json"),
        "reference": ("quality", str(bad), "--reference", name, "--json"),
        "compare": ("compare", name, str(bad), "--json"),
        "deform": ("deform", str(bad), "-s", "boundary=[{select=['*.kmin'], motion=[{translate=[0.01, 0, 0]}]}]",
                   "-o", "out.xyz", "--force", "--json"),
    }  # fmt: skip
    code, out, told = spoken(*arguments[command])
    if code not in (0, 3, *((1,) if command == "compare" else ())):
        return refusal(code, told)
    try:
        found = json.loads(out, parse_constant=_refused)
    except ValueError as error:
        return f"{command} --json: {error}"
    grid = read_grid(bad)
    return _counts(command, found, grid.n_blocks, grid.n_nodes)


def _counts(command: str, found: dict, blocks: int, nodes: int) -> str:
    counts = found.get("grid", found)
    told = counts.get("blocks"), counts.get("nodes")
    told = (len(told[0]) if isinstance(told[0], list) else told[0], told[1])
    if command in ("info", "quality", "deform") and told != (blocks, nodes):
        return f"{command} tells of {told} blocks and nodes, the file has {blocks} and {nodes}"
    return "ok"


def _refused(word: str) -> None:
    raise ValueError(f"{word} is no JSON")


KINDS = {"repair": repair, "looks": looks}
