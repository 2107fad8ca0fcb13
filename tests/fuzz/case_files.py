"""Classes of case files, options, formulas and repairs: what is accepted moves the walls as the case says."""

import functools
import json
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from grids import CASE

from meshdeform_formats import read_grid, write_grid

from . import judges
from .bench import METHODS, Bench, called, refusal
from .mutations import mutated

VALUES = (
    "0", "-1", "1e-300", "1e300", "nan", "inf", "true", "[]", "{}", "''", "'auto'", "'x > 0'", "'lie'", "'tps'", "1.5",
    "'*.kmin'", "['block1.imax']", "'slip'", "'wendland-c2'", "'off'", "40", "[[", "3", "'x" + "(" * 300 + "'", "1e-3",
    "1979-05-27", "07:32:00", "1979-05-27T00:32:00Z", "-nan", "0x1F", "1_000", "9" * 400, "9223372036854775808", "-0.0",
    "'\u00e4\u03b1\U0001f600'", "'\\u0000'", "[[1, 2], [3]]", "[1, 'x', true]", "{a = 1}", "'x/0'", "'(-8)**(1/3)'",
    "'1e400'", "'sqrt(-1)'", "'t'", "'0*x'", "''' x '''", "[0, 0, 0]", "[0, 0, 1e-320]", "['*.i*', '*.i*']", "'**'",
    "'block1.imax[2:1,*]'", "'block1.imax[1:99999999999,*]'", "'[*]'", "'x'*3",
)  # fmt: skip


@functools.cache
def keys() -> tuple[str, ...]:
    """Every key that the schema of case files has, and a few that it has not."""
    code, told = called("schema", "case")
    assert code == 0, told
    found: list[str] = []

    def collect(table: dict[str, Any], prefix: str) -> None:
        for name, value in table.get("properties", {}).items():
            found.append(prefix + name)
            collect(value, f"{prefix}{name}.")
            if name == "boundary":
                for number in ("1", "2", "body", "span", "outer", "9"):
                    collect(value["items"], f"boundary.{number}.")

    collect(json.loads(told), "")
    entries = [f"boundary.{number}.motion" for number in ("body", "span")]
    return (*found, *entries, "constants.turn", "constants.new", "constants.x", "nothing", "grid..tolerance", "method.")


def case(bench: Bench, rng: Random) -> str:
    """The text of a case with a few changes."""
    Path("bad.toml").write_bytes(mutated(CASE.encode(), True, rng))
    text = Path("bad.toml").read_text("utf-8", "replace")
    return bench.deformed(bench.grid, text, "grid.xyz", "-c", "bad.toml", "-m", "tfi")


def options(bench: Bench, rng: Random) -> str:
    """A good case with one key from the command line, most often a wrong one."""
    setting = f"{rng.choice(keys())}={rng.choice(VALUES)}"
    arguments = ("grid.xyz", "-c", "case.toml", "-s", setting, "-m", rng.choice(METHODS))
    return bench.deformed(bench.grid, None, *arguments)


def types(bench: Bench, rng: Random) -> str:
    """A case with any value at any place of it."""
    body = {
        "name": "'body'",
        "select": "['*.i*', '*.j*']",
        "where": "'abs(x) < 0.51 and abs(y) < 0.51'",
        "kind": "'moving'",
        "motion": f"[{{ {rng.choice(_MOTIONS)} }}]",
    }
    span = {"select": "['*.kmin', '*.kmax']", "kind": "'slip'"}
    outer = {"select": "['*.i*', '*.j*']", "where": "'max(abs(x), abs(y)) > 1.99'", "kind": "'fixed'"}
    entries = [body, span, outer]
    for _ in range(rng.choice((1, 1, 2))):
        entry, kind = rng.choice(entries), rng.randrange(5)
        name = rng.choice(list(entry))
        if kind == 0:
            entry[name] = rng.choice(VALUES)
        elif kind == 1:
            del entry[name]
            entry.setdefault("select", "['*']")
        elif kind == 2:
            entry["kind"] = rng.choice(("'moving'", "'fixed'", "'slip'", "'symmetry'", "'periodic'", "'free'"))
        elif kind == 3:
            body["motion"] = f"[{{ {rng.choice(_MOTIONS)} }}, {{ {rng.choice(_MOTIONS)} }}]"
        else:
            rng.shuffle(entries)
    text = "[constants]\nL = 5.0\nturn = 8.0\n" if rng.random() < 0.7 else ""
    for entry in entries:
        text += "[[boundary]]\n" + "".join(f"{key} = {value}\n" for key, value in entry.items())
    Path("bad.toml").write_text(text, "utf-8")
    return bench.deformed(bench.grid, text, "grid.xyz", "-c", "bad.toml", "-m", rng.choice(("tfi", "idw-tfi")))


_MOTIONS = (
    "rotate = { angle = 5, axis = [0, 0, 1] }",
    "rotate = { angle = 'turn', axis = [0, 0, 2], center = [0.1, 0, 0] }",
    "rotate = { angle = '3*z', center = [0, '0.1*x', 0] }",
    "translate = [0.05, '0.01*L', 0]",
    "translate = [0, 0, 0]",
    "displace = ['0.05*sin(x*L)', '0.02*y/(1+x**2)', 0]",
    "displace = ['0.1*where(x > 0 and not y < 0, y, -x)', 'max(x, y)*0.1', '0']",
    "displace = ['x/0', 0, 0]",
    "displace = ['0.1*(x)**0.5', 0, 0]",
    "displace = ['mod(x, 0.3)*0.1', '0.01*floor(9*y)', 0]",
    "displace = ['0.01*atan2(y, x)', '0.03*hypot(x, y)', 0]",
    "displace = ['1e-320*x', '1e-200', 0]",
    "displace = ['9**9**9', 0, 0]",
    "displace = ['0.01*x%0.3', '0.01*(x//0.25)', 0]",
    "displace = ['0.02*(0 < x < 1)', '-0.02*(x != y)', 0]",
)


FOLDED = CASE.replace("turn = 10.0", "turn = 70.0")


def prepare(bench: Bench) -> None:
    """A grid with invalid cells, as another program might make it."""
    Path("folded.toml").write_text(FOLDED)
    arguments = ("deform", "grid.xyz", "-c", "folded.toml", "-m", "tfi", "--repair", "off", "--steps", "1", "-q")
    assert called(*arguments, "--allow-invalid", "-o", "folded.xyz")[0] == 0
    write_grid(read_grid("folded.xyz"), "folded.fmt", {"encoding": "ascii"})


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


KINDS = {"repair": repair, "case": case, "case, types": types, "options": options}
