"""Derivatives of repaired grids: the minimum of the repair's energy is differentiated."""

import numpy as np
import pytest
from cases import every
from grids import frame, frame_2d

import meshdeform as md
from meshdeform.grid import wrapped
from meshdeform_core import stepping
from meshdeform_core.repair import energy, outcome, untangle
from meshdeform_samples import load

BODY = {"where": "abs(x) < 0.51 and abs(y) < 0.51", "select": ["*.i*", "*.j*"], "kind": "moving", "name": "body"}
STILL = [{"displace": ["0", "0", "0"]}]


def prepared(grid, plane=False, ends="slip", **options):
    own = md.Grid([block.copy() for block in wrapped(grid, plane).blocks])
    return md.prepare(own, {**case(plane, ends), **options})


def case(plane, ends):
    span = [] if plane else [{"name": "span", "select": ["*.kmin", "*.kmax"], "kind": ends}]
    return {"boundary": [{**BODY, "motion": STILL}, *span], "method": {"name": "idw-tfi"}}


def bend(mesh, size, twist=0.0):
    x = mesh.points
    wave = twist * np.cos(2.0 * x[:, 2] + x[:, 0])
    return size * np.stack([np.sin(x[:, 1] + 1.0), 0.3 * x[:, 0], wave], axis=1)


def on_a_bulge():
    """The span is a curved surface; no node of the undeformed grid stays at a corner of its flat faces."""
    grid = frame(5, 4)
    x = grid.points.copy()
    x[:, 2] += 0.15 * np.sin(1.1 * x[:, 0]) * np.cos(0.8 * x[:, 1])
    return prepared(grid.moved(x))


CASES = {
    "curved slip": (on_a_bulge, 0.46, 0.15),
    "plane": (lambda: prepared(frame_2d(9), plane=True), 0.8, 0.0),
    "extruded": (lambda: prepared(frame(7, 5)), 0.9, 0.0),
    # What differs along lines fades out.
    "extruded, setting in": (lambda: prepared(frame(7, 5)), 0.75, 0.0),
    "space": (lambda: prepared(frame(5, 4)), 0.6, 0.3),
    "symmetry": (lambda: prepared(frame(5, 4), ends="symmetry"), 0.7, 0.3),
    "periodic": (lambda: prepared(frame(5, 4), ends="periodic"), 0.7, 0.0),
    "polished": (lambda: prepared(frame_2d(9), plane=True, repair={"mode": "polish"}), 0.8, 0.0),
    "polished, folded": (lambda: prepared(frame(5, 4), repair={"mode": "polish"}), 1.5, 0.3),
}


def flat(blocks):
    return np.concatenate([np.ravel(block) for block in blocks])


def check(mesh, at, found, change, steps, intervals=(2e-4, 5e-5)):
    """Both modes of a derivative against central differences, and against each other."""
    moved, errors = flat(found.jvp(change)), []
    for h in intervals:
        one, two = (flat(mesh.deform(at + s * h * change, steps=steps).grid.blocks) for s in (1, -1))
        errors.append(np.abs((one - two) / (2.0 * h) - moved).max() / np.abs(moved).max())
    assert errors[1] < 1e-6
    assert errors[1] < errors[0] / 8 or errors[1] < 1e-7
    assert apart(found, change) < 1e-12


def apart(found, change):
    """How far the two modes of a derivative are from transposes of each other."""
    moved = found.jvp(change)
    weights = [np.random.default_rng(1).standard_normal(block.shape) for block in moved]
    size = np.linalg.norm(flat(weights)) * np.linalg.norm(flat(moved))
    return abs((flat(weights) * flat(moved)).sum() - (found.vjp(weights) * change).sum()) / size


@pytest.fixture(autouse=True)
def early(monkeypatch):
    """Repairs set in at a smaller distortion, so that small motions of small grids need one."""
    healthy, between, full = 2.15, np.log(4.0 / 2.15), np.log(15.0 / 2.15)
    values = {"HEALTHY": healthy, "BETWEEN": between, "FULL": full, "ALONG": (between / full) ** 2}
    for name, value in values.items():
        monkeypatch.setattr(energy, name, value)
    monkeypatch.setattr(outcome.unhealthy_cells, "__defaults__", (healthy,))
    monkeypatch.setattr(stepping, "AS_PLANE", 2.0)


@pytest.fixture
def converged(monkeypatch):
    """Newton's method goes on until a step itself moves no node: differences of grids need more digits than grids."""
    monkeypatch.setattr(untangle, "_SAFETY", np.inf)


def components():
    """Two components of a plane overset grid, of which each has weak cells, and one at rest."""
    own = [block.copy() for block in wrapped(frame_2d(9), True).blocks]
    blocks = [block + [shift, 0.0] for shift in (0.0, 0.3, 0.1) for block in own]
    body = [
        {**BODY, "name": name, "motion": STILL, "select": [f"{name}.*.i*", f"{name}.*.j*"]}
        | {"where": f"abs(x-{shift}) < 0.51 and abs(y) < 0.51"}
        for name, shift in (("a", 0.0), ("b", 0.3))
    ]
    names = [f"{name}.{n}" for name in "abc" for n in range(len(own))]
    given = {"boundary": body, "method": {"name": "idw-tfi"}, "grid": {"components": "zone prefix"}}
    return md.prepare(md.Grid(blocks, names), given)


CASES["components"] = (components, 0.8, 0.0)


@every(CASES, CASES.keys() - {"plane", "extruded, setting in", "periodic", "polished", "polished, folded"})
def test_central_differences_through_a_repair(name, converged):
    make, size, twist = CASES[name]
    mesh = make()
    at = bend(mesh, size, twist)
    found = mesh.linearise(at, steps=1)
    assert found.step.repair.converged
    assert found.exact, found.reason
    x = mesh.points
    change = np.stack([np.cos(3.0 * x[:, 1]), np.sin(4.0 * x[:, 0]), twist * np.cos(x[:, 0])], axis=1)
    moved = flat(found.jvp(change))
    # The method alone would be wrong by far.
    method = flat(mesh.linearise(at, steps=1, repair="off").jvp(change))
    assert np.abs(moved - method).max() > 0.01 * np.abs(moved).max()
    # On curved surfaces nodes cross from one flat face to the next in longer intervals.
    check(mesh, at, found, change, 1, (1e-5, 2.5e-6) if name == "curved slip" else (2e-4, 5e-5))


def test_both_modes_agree_where_many_nodes_slide_on_a_sphere():
    """The matrix is neither that of Newton's method nor its own transpose."""
    kinds = {"membrane": {"motion": STILL}, "plate": {"kind": "fixed"}, "outer": {"kind": "slip"}}
    boundary = [{"name": name, "select": [name], **kind} for name, kind in kinds.items()]
    mesh = md.prepare(wrapped(load("hemisphere").generate(8), False), {"boundary": boundary})
    x, y, z = mesh.points.T
    at = 0.066 / 0.075**2 * (z * np.cos(4.0 * np.arctan2(np.hypot(x, y), z)))[:, None] * mesh.points
    found = mesh.linearise(at, steps=1)
    assert found.step.repair.converged
    assert apart(found, at) < 1e-10
