"""What a repair costs and gives: healthy layer grids, bumps in space, ducts and pipes that close, rings.

python studies/repairs.py                       the table on stdout
python studies/repairs.py --only ring           some of the motions

*alone* is the method without a repair, its processor seconds those of set-up and step; *J* is the smallest scaled
Jacobian, *walls* the angle between first cells and their walls (degrees rms), *x* the ratio of processor seconds.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import numpy as np
from flows import SAMPLES, grids_folder
from motions import displace, rotate
from tables import Row, run

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.motion import Displace, Motion, Rotate
from meshdeform_core.deform import Case, Result, Setup, Timing, impose, set_up
from meshdeform_core.grid import FloatArray, Grid
from meshdeform_core.methods import Options
from meshdeform_formats.grids import read_grid
from meshdeform_samples.reproduce.experiment import Sample, prepare_sample


def _moving(select: str, part: Displace | Rotate) -> BoundarySpec:
    return BoundarySpec("wall", tuple(select.split()), Kind.MOVING, None, Motion((part,), {}))


def _clustered(n: int, first: float, length: float) -> FloatArray:
    """``n`` positions from 0 to ``length`` that grow geometrically from the ``first`` step."""
    low, high = 1.0 + 1e-12, 4.0
    for _ in range(200):
        ratio = (low + high) / 2
        low, high = (ratio, high) if first * (ratio ** (n - 1) - 1) / (ratio - 1) < length else (low, ratio)
    return np.asarray(length * (low ** np.arange(n) - 1.0) / (low ** (n - 1) - 1.0))


def c_grid(around: int = 513, layers: int = 65, far: float = 50.0, first: float = 1.25e-6) -> Grid:
    """One block around a NACA 0012 and its wake, whose sides coincide; the far field is ``far`` chords away."""
    wake, on = around // 8, around - 2 * (around // 8)
    s = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, on)))
    x = np.abs(2.0 * s - 1.0) ** 1.5
    root = np.sqrt(np.maximum(x, 0.0))
    y = 0.6 * (0.2969 * root - 0.1260 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4) * np.sign(2.0 * s - 1.0)
    tail = 1.0 + _clustered(wake + 1, 0.01, far - 1.0)[1:]
    inner = np.concatenate([np.stack([tail[::-1], 0 * tail], 1), np.stack([x, y], 1), np.stack([tail, 0 * tail], 1)])
    # The outer line: two straight parts beside the wake, half a circle around the leading edge.
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(inner, axis=0), axis=1))])
    part = length / length[-1]
    angle = np.pi * np.clip((part - part[wake]) / (part[wake + on - 1] - part[wake]), 0.0, 1.0)
    outer = np.stack([-far * np.sin(angle), -far * np.cos(angle)], axis=1)
    outer[:wake, 0], outer[-wake:, 0] = inner[:wake, 0] - 1.0, inner[-wake:, 0] - 1.0
    share = _clustered(layers, first, 1.0)[None, :, None] * np.ones((1, 1, 1))
    block = inner[:, None] + share * (outer - inner)[:, None]
    return Grid.from_blocks([np.concatenate([block, np.zeros((*block.shape[:2], 1))], axis=-1)[:, :, None]])


def _airfoil(angle: float, around: int = 513, layers: int = 65) -> Setup:
    wake = around // 8
    wall = _moving(f"block1.jmin[{wake + 1}:{around - wake},*]", rotate(str(angle), (0, 0, 1), 0.25, 0, 0))
    rest = BoundarySpec("far", ("block1.jmax", "block1.imin", "block1.imax"), Kind.FIXED)
    return set_up(c_grid(around, layers), Case((wall, rest)))


def _cube(n: int, height: float, far: float = 0.0) -> Setup:
    x = np.linspace(0.0, 1.0, n)
    grid = Grid.from_blocks([np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1) + far])
    bump = displace("0", "0", f"{height}*exp(-((x-{far + 0.5})**2+(y-{far + 0.5})**2)/0.02)")
    return set_up(grid, Case((_moving("block1.kmin", bump), BoundarySpec("rest", ("*",), Kind.FIXED))))


def _duct(ni: int, nj: int, gap: float, slip: bool = False) -> Setup:
    """A plane duct, or one in space with slip sides, that closes to ``gap`` of its height in the middle."""
    x, y = np.linspace(-3.0, 3.0, ni), np.linspace(0.0, 1.0, nj)
    z = np.linspace(0.0, 1.0, nj) if slip else np.zeros(1)
    block = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    swell = f"-{1.0 - gap}*exp(-(x/0.5)**2)" + ("*cos(pi*(z-0.5))**2" if slip else "")
    specs = [_moving("*.jmax", displace("0", swell, "0")), BoundarySpec("floor", ("*.jmin",), Kind.FIXED)]
    sides = [BoundarySpec("sides", ("*.k*",), Kind.SLIP)] if slip else []
    return set_up(Grid.from_blocks([block]), Case((*specs, *sides)))


def _pipe(n: int, long: int, gap: float, bump: float) -> Setup:
    """A pipe of a square and four blocks around it, whose wall comes down to ``gap`` of the radius over ``bump``."""
    z, side = np.linspace(-3.0, 3.0, long), np.linspace(-0.35, 0.35, n)
    x, y, h = np.meshgrid(side, side, z, indexing="ij")
    blocks = [np.stack([x, y, h], axis=-1)]
    share = np.linspace(0.0, 1.0, n)[:, None, None]
    for quarter in range(4):
        angle = np.pi / 4 * np.linspace(-1.0, 1.0, n)[None, :, None] + np.pi / 2 * quarter
        edge = np.stack([np.full(n, 0.35), side], axis=0)[:, None, :, None]
        c, s = np.cos(np.pi / 2 * quarter), np.sin(np.pi / 2 * quarter)
        inner = np.stack([c * edge[0] - s * edge[1], s * edge[0] + c * edge[1]], axis=0)
        outer = np.stack([np.cos(angle), np.sin(angle)], axis=0)
        plane = inner + share * (outer - inner)
        block = np.stack(
            [*(np.broadcast_to(p, (n, n, long)) for p in plane), np.broadcast_to(z, (n, n, long))], axis=-1
        )
        blocks.append(np.ascontiguousarray(block))
    shrink = f"-{1.0 - gap}*exp(-(z/{bump})**2)"
    walls = " ".join(f"block{b}.imax" for b in range(2, 6))
    wall = _moving(walls, displace(f"x*{shrink}", f"y*{shrink}", "0"))
    ends = BoundarySpec("ends", ("*.kmin", "*.kmax"), Kind.SLIP)
    return set_up(Grid.from_blocks(blocks), Case((wall, ends)))


def _ring(angle: float) -> Setup:
    grid = read_grid(grids_folder() / "cylinder_ring_4blk.x")
    wall = _moving("*.jmax", rotate(str(angle), (0, 0, 1), 0, 0, 0))
    return set_up(grid, Case((wall, BoundarySpec("ends", ("*.k*",), Kind.SLIP))))


def _valve(angle: float) -> Setup:
    return prepare_sample(Sample("valve", SAMPLES["valve"], constants=(("opening", angle),)))


MOTIONS: dict[str, Callable[[], Setup]] = {
    **{f"C-grid, pitch {a} degrees": (lambda a=a: _airfoil(a)) for a in (45, 75, 120, 170)},
    "small C-grid, pitch 75 degrees": lambda: _airfoil(75, 129, 33),
    **{f"valve, {a} degrees": (lambda a=a: _valve(a)) for a in (35,)},
    "cube 21, bump .35": lambda: _cube(21, 0.35),
    "cube 65, bump .35": lambda: _cube(65, 0.35),
    "cube 101, bump .35": lambda: _cube(101, 0.35),
    **{f"cube 9 at {far:g}, bump .45": (lambda far=far: _cube(9, 0.45, far)) for far in (0.0, 1e6, 1e8, 1e11)},
    **{f"duct, gap {gap}": (lambda gap=gap: _duct(121, 41, gap)) for gap in (0.1, 0.05)},
    "duct with slip sides, gap .2": lambda: _duct(61, 21, 0.2, slip=True),
    **{
        f"pipe {n} x {long}, gap .03 over {b}": (lambda n=n, long=long, b=b: _pipe(n, long, 0.03, b))
        for n, long, b in ((13, 41, 0.5), (13, 41, 1.0), (11, 41, 0.3), (15, 51, 0.75), (11, 81, 1.5))
    },
    **{f"ring, {a} degrees": (lambda a=a: _ring(a)) for a in (45, 60, 75)},
}


def _timed(setup: Setup, mode: str, method: str = "idw-tfi") -> tuple[Result, float]:
    case = dataclasses.replace(
        setup.case,
        method=Options(method),
        repair=dataclasses.replace(setup.case.repair, mode=mode),  # type: ignore[arg-type]
    )
    setup, start = dataclasses.replace(setup, case=case), time.process_time()
    return impose(setup, setup.motion(0.1), None, "float64", Timing()), time.process_time() - start


def _cell(result: Result) -> str:
    after = result.assessment.after
    walls = after.wall_normal_deviation_deg
    shown = f"{after.invalid_cells} invalid" if after.invalid_cells else f"{after.min_scaled_jacobian:.3f}"
    return f"{shown} / {walls.rms if walls else 0.0:.1f}"


def row(name: str, make: Callable[[], Setup]) -> Row:
    """One row: a motion by the default method, without and with a repair."""
    begin = time.process_time()
    setup = make()
    set_up_in = time.process_time() - begin
    alone, seconds = _timed(setup, "off")
    found, repaired = _timed(setup, "auto")
    done = found.repair
    return {
        "motion": name,
        "nodes": setup.grid.n_nodes,
        "alone: J / walls": _cell(alone),
        "CPU s": seconds + set_up_in,
        "repaired": _cell(found),
        "x": (repaired + set_up_in) / (seconds + set_up_in),
        "Newton steps": f"{done.newton_steps}{'' if done.converged else ', unfinished'}" if done else "0",
        "invalid, weak": f"{done.invalid}, {done.weak}" if done else "",
        "moved": f"{done.nodes} by {done.max_movement / found.max_displacement:.2f}" if done else "0",
        "tfi, repaired": _cell(_timed(setup, "auto", "tfi")[0]) if name.startswith(("ring", "valve")) else "",
        "attempts": len(found.attempts),
    }


def main() -> None:
    """The command line."""
    run(lambda: MOTIONS, row, __doc__, __file__)


if __name__ == "__main__":
    main()
