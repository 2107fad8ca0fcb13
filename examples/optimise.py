"""Aerodynamic shape optimisation with adjoints: less suction for a NACA 0012 section at the same lift and area.

Run it with ``python examples/optimise.py FOLDER``. Potential flow is solved on the grid, so that lift and suction
depend on all of its nodes. ``Linearisation.vjp`` turns their gradients into gradients with respect to the wall, and
those of the grid's volume and quality, which are constraints. scipy's SLSQP does the rest.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import splu

import meshdeform as md

Array = NDArray[np.float64]
Gradient = tuple[float, Array, float]
"""A function of the flow: its value, its gradient (n, 2) with respect to the nodes, and that to the angle of attack."""

AROUND, ALONG, RADIUS = 161, 57, 15.0
"""Nodes around the section and along a grid line, radius of the grid (chords)."""
LIFT, MOST_SKEW, POWER = 0.6, 1.2, 10
"""Lift coefficient, largest growth of the grid's skewness 1 - f_skew, exponent of the norm in place of the maximum."""
STATIONS = (0.12, 0.25, 0.4, 0.55, 0.7)
"""Where the bumps on both sides are largest (chords)."""
NACA = (0.2969, -0.1260, -0.3516, 0.2843, -0.1036)


def section_grid(around: int = AROUND, along: int = ALONG) -> md.Grid:
    """An O-grid around NACA 0012, from -0.5 to 0.5: the conformal grid of an ellipse, deformed."""
    a, b = 0.5, 0.06
    theta, r = np.linspace(0.0, 2.0 * np.pi, around), (a + b) / 2
    circle = np.exp(1j * theta)[:, None] * r * (RADIUS / r) ** (np.linspace(0.0, 1.0, along) ** 1.5)
    plane = circle + (a * a - b * b) / 4 / circle
    plane[-1] = plane[0]
    mesh = prepared(md.Grid([np.stack([plane.real, plane.imag], axis=-1)]))
    t = np.clip(mesh.points[:, 0] + 0.5, 0.0, 1.0)
    half = 0.6 * (NACA[0] * np.sqrt(t) + t * np.polyval(NACA[:0:-1], t))
    displacement = np.zeros_like(mesh.points)
    displacement[:, 1] = np.sign(np.round(mesh.points[:, 1], 9)) * half - mesh.points[:, 1]
    return md.Grid(mesh.deform(displacement).grid.blocks)


def prepared(grid: md.Grid) -> md.Mesh:
    """The section moves, the outer circle stays."""
    return md.prepare(grid, moving={"section": ["block1.jmin"]}, fixed={"outer": ["block1.jmax"]})


class Flow:
    """Potential flow on an O-grid of (ni, nj) nodes: stream function on linear triangles, two for each cell.

    The stream function is that of the undisturbed flow on the outer circle, and one unknown constant on the section,
    whose streamline leaves along the grid line from the trailing edge (Kutta condition). Chord and speed are 1.
    """

    def __init__(self, ni: int, nj: int) -> None:
        self.shape, count = (ni, nj), (ni - 1) * nj
        node = np.arange(count).reshape(ni - 1, nj)
        beside = np.roll(node, -1, axis=0)
        cells = [(node[:, :-1], beside[:, :-1], beside[:, 1:]), (node[:, :-1], beside[:, 1:], node[:, 1:])]
        self.triangles = np.concatenate([np.stack(corners, axis=-1).reshape(-1, 3) for corners in cells])
        self.wall, self.outer, inner = node[:, 0], node[:, -1], node[:, 1:-1].ravel()
        # Triangles with an edge on the section, where the speed is that along the wall.
        self.edges = np.flatnonzero(np.isin(self.triangles, self.wall).sum(axis=1) == 2)
        # Unknowns: the inner nodes, and one for the section.
        known = np.full(count, -1)
        known[inner], known[self.wall] = np.arange(len(inner)), len(inner)
        free = np.flatnonzero(known >= 0)
        size = len(inner) + 1
        self.spread = csr_matrix((np.ones(len(free)), (free, known[free])), shape=(count, size))
        last = csr_matrix(([1.0, -1.0], ([0, 0], [int(known[node[0, 1]]), size - 1])), shape=(1, size))
        keep = csr_matrix((np.ones(size - 1), (np.arange(size - 1),) * 2), shape=(size, size))
        self.keep, self.kutta = keep, csr_matrix(([1.0], ([size - 1], [0])), shape=(size, 1)) @ last

    def nodes(self, block: Array) -> Array:
        """Coordinates (n, 2) of the nodes of a block, those of the seam once."""
        return block[:-1].reshape(-1, 2)

    def block(self, gradient: Array) -> Array:
        """A gradient with respect to the nodes as one with respect to the block; it counts on one side of the seam."""
        block = np.zeros((*self.shape, 2))
        block[:-1] = gradient.reshape(self.shape[0] - 1, self.shape[1], 2)
        return block

    def solve(self, x: Array, alpha: float) -> Solution:
        """The flow at nodes ``x`` (n, 2) and an angle of attack (radians)."""
        edge, area = _geometry(x[self.triangles])
        local = np.einsum("tic,tjc->tij", edge, edge) / (4.0 * area[:, None, None])
        rows, columns = np.broadcast_arrays(self.triangles[:, :, None], self.triangles[:, None, :])
        stiffness = coo_matrix((local.ravel(), (rows.ravel(), columns.ravel())), shape=(len(x), len(x))).tocsr()
        far, turned = np.zeros(len(x)), np.zeros(len(x))
        (u, v), direction = x[self.outer].T, (np.cos(alpha), np.sin(alpha))
        far[self.outer] = v * direction[0] - u * direction[1]
        turned[self.outer] = -v * direction[1] - u * direction[0]
        matrix = self.keep @ self.spread.T @ stiffness @ self.spread + self.kutta
        factors = splu(matrix.tocsc())
        psi = far - self.spread @ factors.solve(self.keep @ (self.spread.T @ (stiffness @ far)))
        return Solution(self, x, stiffness, factors, psi, turned)


def _geometry(corner: Array) -> tuple[Array, Array]:
    """Edges (n, 3, 2) opposite to the corners (n, 3, 2) of triangles, and areas (n,)."""
    edge = np.roll(corner, -2, axis=1) - np.roll(corner, -1, axis=1)
    return edge, 0.5 * (edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0])


def _turned(edge: Array) -> Array:
    """Gradient (n, 3, 2) of the areas with respect to the corners."""
    return 0.5 * np.stack([-edge[..., 1], edge[..., 0]], axis=-1)


def _steps(values: Array) -> Array:
    """Change (n, 3, 1) of sum_i values_i edge_i with a corner, a multiple of the identity."""
    return (np.roll(values, -1, axis=1) - np.roll(values, -2, axis=1))[..., None]


@dataclass
class Solution:
    """A flow: the stream function ``psi`` (n,), and what adjoints need."""

    flow: Flow
    x: Array
    stiffness: Any
    factors: Any
    psi: Array
    turned: Array

    def lift(self) -> Gradient:
        """Lift coefficient: twice the circulation, which is the flux of grad psi through the section."""
        section = np.zeros(len(self.x))
        section[self.flow.wall] = 2.0
        slope = self.stiffness @ section
        return float(slope @ self.psi), *self._total(slope, self._bilinear(section, self.psi))

    def speed(self) -> Array:
        """Squared speed (ni - 1,) on the edges of the section."""
        edge, area = _geometry(self.x[self.flow.triangles[self.flow.edges]])
        gradient = np.einsum("ti,tic->tc", self.psi[self.flow.triangles[self.flow.edges]], edge)
        return np.asarray((gradient**2).sum(axis=1) / (4.0 * area**2))

    def suction(self) -> Gradient:
        """The norm of 1 - cp, the squared speed, over the section: nearly its maximum."""
        at = self.flow.triangles[self.flow.edges]
        edge, area = _geometry(self.x[at])
        g, squares = np.einsum("ti,tic->tc", self.psi[at], edge), self.speed()
        mean = float((squares**POWER).mean())
        weight = mean ** (1.0 / POWER - 1.0) * squares ** (POWER - 1) / len(squares)
        slope, partial = np.zeros(len(self.x)), np.zeros_like(self.x)
        np.add.at(slope, at, (weight / (2.0 * area**2))[:, None] * np.einsum("tic,tc->ti", edge, g))
        change = _steps(self.psi[at]) * (g / (2.0 * area**2)[:, None])[:, None]
        change -= (2.0 * squares / area)[:, None, None] * _turned(edge)
        np.add.at(partial, at, weight[:, None, None] * change)
        return mean ** (1.0 / POWER), *self._total(slope, partial)

    def _total(self, slope: Array, partial: Array) -> tuple[Array, float]:
        """Gradients of a function from its partial ones with respect to psi (n,) and to the nodes, by the adjoint."""
        adjoint = self.flow.spread @ (self.flow.keep @ self.factors.solve(self.flow.spread.T @ slope, "T"))
        by_angle = (slope - self.stiffness @ adjoint) @ self.turned
        return partial - self._bilinear(adjoint, self.psi), float(by_angle)

    def _bilinear(self, a: Array, b: Array) -> Array:
        """Gradient (n, 2) of a' K b with respect to the nodes."""
        at = self.flow.triangles
        edge, area = _geometry(self.x[at])
        one, two = (np.einsum("ti,tic->tc", values[at], edge) for values in (a, b))
        change = (_steps(a[at]) * two[:, None] + _steps(b[at]) * one[:, None]) / (4.0 * area)[:, None, None]
        change -= ((one * two).sum(axis=1) / (4.0 * area**2))[:, None, None] * _turned(edge)
        total = np.zeros_like(self.x)
        np.add.at(total, at, change)
        return total


@dataclass
class Shape:
    """What the optimiser asks about a design: angle of attack (degrees), then heights of the bumps (% chord)."""

    mesh: md.Mesh
    flow: Flow
    history: list[dict[str, float]] = field(default_factory=list)
    _design: Array = field(default_factory=lambda: np.empty(0))
    _found: dict[str, tuple[float, Array]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        t = np.clip(self.mesh.points[:, 0] + 0.5, 0.0, 1.0)
        bumps = np.array([np.sin(np.pi * t ** (np.log(0.5) / np.log(station))) ** 3 for station in STATIONS])
        upper = self.mesh.points[:, 1] > 0
        self.bumps = np.concatenate([bumps * upper, bumps * ~upper])

    def at(self, design: Array) -> dict[str, tuple[float, Array]]:
        """Values and gradients; those of the last design are kept."""
        if not np.array_equal(design, self._design):
            self._found, self._design = self._evaluated(design), design.copy()
        return self._found

    def displacement(self, design: Array) -> Array:
        """Of the section: bumps move its upper or lower side along y."""
        displacement = np.zeros_like(self.mesh.points)
        displacement[:, 1] = 0.01 * design[1:] @ self.bumps
        return displacement

    def _evaluated(self, design: Array) -> dict[str, tuple[float, Array]]:
        at = self.mesh.linearise(self.displacement(design), steps=1, repair="off")
        if not at.step.valid:
            raise SystemExit(f"{at.step}: bounds of the design that are too wide")
        flow = self.flow.solve(self.flow.nodes(at.step.grid.blocks[0]), np.radians(design[0]))
        found = {}
        for name, (value, gradient, by_angle) in (("suction", flow.suction()), ("lift", flow.lift())):
            found[name] = value, self._pulled(at, self.flow.block(gradient), np.radians(by_angle))
        for name in ("volume", "f_skew"):
            quality = at.step.quality_gradient(name)
            found[name] = quality.value, self._pulled(at, quality.blocks[0], 0.0)
        return found

    def _pulled(self, at: Any, block: Array, by_angle: float) -> Array:
        """Gradient with respect to the design from that with respect to the nodes."""
        return np.array([by_angle, *(0.01 * self.bumps @ at.vjp([block])[:, 1])])

    def remember(self, design: Array) -> None:
        """A line of the history."""
        self.history.append({name: value for name, (value, _) in self.at(design).items()})


def optimise(around: int = AROUND, along: int = ALONG, most: int = 60) -> tuple[Shape, Array, Array]:
    """The problem, its first design, and the best one."""
    mesh = prepared(section_grid(around, along))
    shape = Shape(mesh, Flow(around, along))
    start = np.zeros(1 + 2 * len(STATIONS))
    value, gradient = shape.at(start)["lift"]
    start[0] = (LIFT - value) / gradient[0]
    first = shape.at(start)
    volume, quality = first["volume"][0], 1.0 - MOST_SKEW * (1.0 - first["f_skew"][0])
    shape.remember(start)

    def of(name: str, sign: float, limit: float, scale: float = 1.0) -> dict[str, Any]:
        return {
            "fun": lambda design: sign * scale * (shape.at(design)[name][0] - limit),
            "jac": lambda design: sign * scale * shape.at(design)[name][1],
        }

    found = minimize(
        lambda design: shape.at(design)["suction"][0],
        start,
        jac=lambda design: shape.at(design)["suction"][1],
        bounds=[(-5.0, 10.0), *[(-2.0, 2.0)] * (len(start) - 1)],
        constraints=[
            {"type": "eq", **of("lift", 1.0, LIFT)},
            # A grid that does not grow keeps the area of the section.
            {"type": "ineq", **of("volume", -1.0, volume, 10.0)},
            {"type": "ineq", **of("f_skew", 1.0, quality, 1000.0)},
        ],
        callback=shape.remember,
        method="SLSQP",
        options={"maxiter": most, "ftol": 1e-5},
    )
    if not found.success and found.nit < most:
        raise SystemExit(f"SLSQP: {found.message}")
    return shape, start, found.x


def picture(shape: Shape, start: Array, best: Array, file: Path) -> None:
    """Both grids, the pressure on both sections, and the history."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(11, 7), layout="constrained", height_ratios=[1.15, 1])
    colors = ("0.45", "tab:blue")
    for ax, design, color, title in zip(axes[0], (start, best), colors, ("NACA 0012", "less suction"), strict=True):
        block = shape.mesh.deform(shape.displacement(design), repair="off").grid.blocks[0]
        ax.plot(block[..., 0], block[..., 1], color=color, linewidth=0.4)
        ax.plot(block[..., 0].T, block[..., 1].T, color=color, linewidth=0.4)
        ax.fill(*block[:, 0].T, facecolor="white", edgecolor="black", linewidth=1.2)
        name = f"{title}: angle of attack {design[0]:.2f}°"
        ax.set(xlim=(-0.65, 0.65), ylim=(-0.36, 0.36), aspect="equal", title=name, xticks=[], yticks=[])
        x = shape.flow.nodes(block)
        wall = x[shape.flow.wall]
        middle = 0.5 * (wall + np.roll(wall, -1, axis=0))[:, 0]
        squares = shape.flow.solve(x, np.radians(design[0])).speed()
        axes[1, 0].plot(middle + 0.5, 1.0 - squares, color=color, label=title)
    axes[1, 0].set(xlabel="x / chord", ylabel="pressure coefficient", ylim=(1.1, -2.3))
    axes[1, 0].legend(frameon=False)
    first = shape.mesh.points[:, :2]
    _history(axes[1, 1], shape.history, 0.5 * abs(float(_cross(first, np.roll(first, -1, axis=0)).sum())))
    for ax in axes[1]:
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(alpha=0.3)
    figure.savefig(file, dpi=100)
    plt.close(figure)


def _cross(one: Array, other: Array) -> Array:
    return np.asarray(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])


def _history(ax: Any, history: list[dict[str, float]], area: float) -> None:
    """Objective and constraints by iteration, each relative to its first value or to what is required; ``area`` is that
    of the first section."""
    first = history[0]
    lines = {
        "suction: norm of 1 - cp": [each["suction"] / first["suction"] for each in history],
        "lift": [each["lift"] / LIFT for each in history],
        "area of the section": [1.0 - (each["volume"] - first["volume"]) / area for each in history],
        "skewness of the grid: 1 - f_skew": [(1.0 - each["f_skew"]) / (1.0 - first["f_skew"]) for each in history],
    }
    looks = (("-", "tab:blue"), ("--", "0.3"), (":", "tab:green"), ("-", "tab:orange"))
    for (label, values), (style, color) in zip(lines.items(), looks, strict=True):
        ax.plot(values, style, color=color, linewidth=1.8, label=label)
    ax.axhline(MOST_SKEW, color="tab:orange", linewidth=0.8, linestyle=":")
    ax.text(0, MOST_SKEW + 0.01, "limit", color="tab:orange", va="bottom", fontsize=9)
    ax.set(xlabel="iteration", ylabel="relative to first or required", ylim=(0.4, 1.35))
    ax.legend(frameon=False, loc="lower left", fontsize=9)


def main(folder: Path) -> None:
    """Optimise, write the grid and the picture."""
    shape, start, best = optimise()
    first, last = shape.history[0], shape.history[-1]
    for name in first:
        print(f"{name:20} {first[name]:10.5f} {last[name]:10.5f}", file=sys.stderr)
    step = shape.mesh.deform(shape.displacement(best), repair="off")
    print(step, file=sys.stderr)
    md.write(step.grid, folder / "section.xyz", force=True)
    picture(shape, start, best, folder / "optimise.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
