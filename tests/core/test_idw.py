"""IDW against a slow twin, the limits it must have, and its options."""

import itertools

import numpy as np
import pytest
from cases import apply, body_specs, problem_of, turning
from grids import block_around, frame, frame_2d, polar
from reference.idw import slow_idw

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.boundary.motions.motion import Displace, Motion, Rotate
from meshdeform_core.boundary.prescribed import prescribed_displacement
from meshdeform_core.deform import Case, deform
from meshdeform_core.errors import MethodError
from meshdeform_core.grid import Grid
from meshdeform_core.methods import IDW, Options, make_method
from meshdeform_core.methods.scattered.mirror import mirror_images
from meshdeform_core.methods.scattered.transition import MovingShare, attached
from meshdeform_core.numerics.exact.direct import weighted_sums
from meshdeform_core.numerics.geometry import quaternions as rot
from meshdeform_core.numerics.rigid import Transition, finish
from meshdeform_core.numerics.rotation import SurfaceRotations
from meshdeform_core.repair import RepairOptions
from meshdeform_samples import load
from meshdeform_samples.reproduce.paper_methods import ReweightedIDW

VARIANTS = {
    "none": IDW(rotation="none"),
    "quaternion": IDW(rotation="quaternion"),
    "quaternion without mean": IDW(rotation="quaternion", remove_mean=True),
    "division reweighted": ReweightedIDW(rotation="division", divisions=5),
    "division": IDW(rotation="division", divisions=5),
    "blend": IDW(rotation="blend"),
    "lie": IDW(),
    "lie with mean": IDW(remove_mean=False),
    "lie as in the paper": IDW(a=3.0, smoothing=0, transition=0),
    "lie by weights": IDW(transition=0),
    "smooth transition": IDW(transition=0.5),
    "short ends": IDW(transition=0.1, a=3.5),
    "one round": IDW(smoothing=1),
    "quaternion smoothed": IDW(rotation="quaternion", smoothing=3),
    "other exponents": IDW(a=2.0, b=4.5, alpha=0.3),
    "auto alpha": IDW(alpha="auto"),
    "length": IDW(length=2.0),
    "shepard": IDW(weights="shepard", p_moving=4.0, p_fixed=2.0),
}


def told(problem):
    return prescribed_displacement(problem.grid, problem.topology, problem.boundary)[problem.source_numbers]


# Others are in space as in the plane.
IN_SPACE = ("none", "quaternion", "division reweighted", "division", "blend", "lie", "quaternion smoothed", "shepard")


@pytest.mark.parametrize(
    ("name", "grid"),
    [*((name, frame_2d(4)) for name in VARIANTS), *((name, frame(3, 2)) for name in IN_SPACE)],
)
def test_slow_twin(name, grid):
    bend = body_specs(turning(25))[: 2 if grid.dimension == 3 else 1]
    problem = problem_of(grid, bend)
    moved = apply(Options("idw", idw=VARIANTS[name]), problem, told(problem))
    inside = np.setdiff1d(np.arange(grid.n_nodes), problem.topology.face_nodes)
    targets = inside[:: max(1, len(inside) // 12)]
    expected = slow_idw(problem, told(problem), grid.points[targets], VARIANTS[name])
    np.testing.assert_allclose(moved[targets], expected, atol=1e-12)


def test_division_converges_to_lie_as_one_over_m():
    problem = problem_of(frame(), body_specs(turning(30, center=(0.4, -0.3, 0.0))))
    displacement = told(problem)
    lie = apply(Options("idw", idw=IDW(remove_mean=False, smoothing=0, a=3.0, transition=0)), problem, displacement)
    errors = []
    for m in (10, 20, 40):
        moved = apply(Options("idw", idw=IDW(rotation="division", divisions=m)), problem, displacement)
        errors.append(np.abs(moved - lie).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all((orders > 0.9) & (orders < 1.1))


def test_quaternion_depends_on_the_origin_and_blend_shrinks():
    grid = frame()
    here = problem_of(grid, body_specs(turning(60)))
    near = expression("abs(x - 3) < 0.51 and abs(y) < 0.51", {"x", "y", "z"})
    specs = [
        BoundarySpec("body", ("*.i*", "*.j*"), Kind.MOVING, near, turning(60, center=(3, 0, 0))),
        body_specs(turning(60))[1],
    ]
    there = problem_of(grid.moved(grid.points + [3.0, 0, 0]), specs)
    quaternion = Options("idw", idw=IDW(rotation="quaternion"))
    gap = np.abs(apply(quaternion, here, told(here)) - apply(quaternion, there, told(there))).max()
    assert gap > 1e-2
    assert np.abs(apply(Options("idw"), here, told(here)) - apply(Options("idw"), there, told(there))).max() < 1e-12


@pytest.mark.parametrize("name", ["idw", "idw-tfi"])
@pytest.mark.parametrize(
    "grid", [polar(), Grid.from_blocks([block_around(np.linspace(0, 9, 19), *[np.linspace(0, 1, 5)] * 2)])]
)
def test_a_boundary_that_stretches_and_shears_carries_its_grid_along(name, grid):
    """Not where it encloses no grid: a body that is stretched among slip planes stretches nothing far away."""
    affine = np.array([[0.3, 0.4, 0.0], [-0.2, 0.1, 0.1], [0.0, 0.1, -0.3]])
    moved = apply(Options(name), problem_of(grid), lambda x: x @ affine.T + [0.1, 0.2, 0.0])
    np.testing.assert_allclose(moved, grid.points @ affine.T + [0.1, 0.2, 0.0], atol=1e-13)
    alone = problem_of(frame(), [body_specs(turning(0))[0], BoundarySpec("rest", ("*",), Kind.SLIP)])
    far = apply(Options(name), alone, lambda x: x * [0.5, -0.3, 0.0])
    assert np.abs(far).max() < 0.3


def test_auto_alpha_is_eq_18_capped_and_says_so():
    problem = problem_of(frame(), body_specs(turning(60)))
    prepared = make_method(Options("idw", idw=IDW(alpha="auto"))).prepare(problem)
    prepared.apply(told(problem))
    setting = prepared.account.settings["alpha"]
    assert setting.value == 0.3
    assert "eq. 18" in setting.reason
    assert "capped" in setting.reason
    small = problem_of(frame(), body_specs(turning(1)))
    prepared.apply(told(small))
    assert 0.001 < prepared.account.settings["alpha"].value < 0.3


@pytest.mark.parametrize(
    "options",
    [
        {"rotation": "quaternions"}, {"weights": "luk"}, {"alpha": 0}, {"alpha": -1.0}, {"alpha": "automatic"},
        {"alpha": float("nan")}, {"a": True}, {"p_moving": "3"}, {"eta": "5"}, {"divisions": 0}, {"divisions": 2.5},
        {"remove_mean": "yes"}, {"length": 0}, {"p_fixed": None}, {"divisions": True},
    ],
)  # fmt: skip
def test_bad_options(options):
    with pytest.raises(MethodError, match=r"method\.idw\."):
        IDW(**options)


@pytest.mark.parametrize("exponents", [(3, 5), (2, 4.5)])
@pytest.mark.parametrize("n_values", [3, 7, 12])
def test_sums(exponents, n_values):
    rng = np.random.default_rng(0)
    targets, sources = rng.random((130, 3)), rng.random((301, 3))
    strength, values = rng.random(301), rng.standard_normal((n_values, 301))
    r = np.linalg.norm(targets[:, None] - sources, axis=2)
    w = strength * (r ** -exponents[0] + 0.3 * r ** -exponents[1])
    sums = weighted_sums(targets, sources, strength, (*exponents, 0.3), values)
    np.testing.assert_allclose(sums[:, 0], w.sum(axis=1), rtol=1e-13)
    np.testing.assert_allclose(sums[:, 1:], w @ values.T, rtol=1e-10, atol=1e-8)


def test_rigid_motions_of_surfaces_are_found():
    """A bent sheet turned as a whole: every node gets that turn, also for in-plane turns and sharp edges."""
    u, v = np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 4), indexing="ij")
    x = np.stack([u, v, np.abs(u - 0.5)], axis=-1).reshape(-1, 3)
    index = np.arange(20).reshape(5, 4)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    from meshdeform_core.methods.base import _rings

    corners, edges = _rings(quads)
    rotations = SurfaceRotations(x, corners, edges)
    for w in ([0, 0, 1.2], [0.3, -0.8, 0.5], [2.0, 2.0, 0.5], [0, 0, 0]):
        q = rot.quaternion_of(np.array([w], dtype=float))
        turned = rot.rotate(np.tile(q, (20, 1)), x) + np.array([1.0, -2.0, 3.0])
        for _ in range(2):
            # The second time they are those kept.
            np.testing.assert_allclose(rotations.vectors(turned - x), np.tile(w, (20, 1)), atol=1e-12)


def sheet(n, m):
    u, v = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, m), indexing="ij")
    index = np.arange(n * m).reshape(n, m)
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    return np.stack([u, v, np.abs(u - 0.5) + 0.1 * v**2], axis=-1).reshape(-1, 3), quads


@pytest.mark.parametrize("plane", [False, True])
def test_rotations_of_a_moved_part_are_those_of_the_whole_surface(plane):
    from meshdeform_core.methods.base import _rings

    rng = np.random.default_rng(1)
    x, quads = sheet(9, 8)
    if plane:
        x, quads = x * [1.0, 1.0, 0.0], quads[:, :2]
    corners, edges = _rings(quads)
    rotations = SurfaceRotations(x, corners, edges, np.array([0.0, 0.0, 1.0]) if plane else None)
    for chosen in ([30, 31, 40], [30, 31, 40], [0], list(range(len(x)))):
        moved = np.zeros_like(x)
        moved[chosen] = 0.05 * rng.standard_normal((len(chosen), 3)) * [1, 1, not plane]
        whole = rotations._fitted(x + moved)
        found = rotations.quaternions(moved)
        np.testing.assert_allclose(found, whole, rtol=0, atol=1e-15)
        np.testing.assert_array_equal(rotations.vectors(moved), rot.rotation_vector(found))
        assert (found[:, 0] < 1.0).any()
    assert (rotations.quaternions(0 * x) == [1.0, 0.0, 0.0, 0.0]).all()


def test_rotations_at_a_thin_trailing_edge_do_not_jump():
    """The edges across it nearly follow its mean normal, and a small shear turns their projections by any angle."""
    grid, positions = load("wing").generate(12), []
    names = {"x", "y", "z", "t"}
    for stroke in np.linspace(0.876, 0.886, 5):
        center = tuple(expression(part, ()) for part in ("0.25", "0", "0"))
        twist = Rotate(expression(f"{stroke}*20*y", names), (0.0, 1.0, 0.0), center)
        bend = Displace(tuple(expression(part, names) for part in ("0", "0", f"{stroke}*0.25*y**2")))
        specs = (
            BoundarySpec("wall", ("wing",), Kind.MOVING, None, Motion((twist, bend), {})),
            BoundarySpec("symmetry", ("symmetry",), Kind.SYMMETRY),
            BoundarySpec("far", ("far",), Kind.FIXED),
        )
        positions.append(deform(grid, Case(specs, repair=RepairOptions("off")), steps=1).grid.points)
    largest = [np.linalg.norm(two - one, axis=1).max() for one, two in itertools.pairwise(positions)]
    assert max(largest) < 1.05 * min(largest)


def test_logarithm_and_exponential_are_inverse():
    rng = np.random.default_rng(5)
    for scale in (1e-9, 1e-3, 0.0316, 0.5, 3.0):
        w = rng.standard_normal((50, 3))
        w *= scale / np.linalg.norm(w, axis=1, keepdims=True)
        t = rng.standard_normal((50, 3))
        np.testing.assert_allclose(rot.rotation_vector(rot.quaternion_of(w)), w, rtol=1e-12, atol=1e-18)
        np.testing.assert_allclose(rot.translation_of_twist(w, rot.twist_velocity(w, t)), t, atol=1e-12)


def share_at(heights, gap, breadth):
    """Shares between two planes with a = 4, one of which moves, from :func:`finish_twist`."""
    heights = np.asarray(heights)
    sums = np.zeros((len(heights), 8))
    moving, rest = np.pi / heights**2, np.pi / (gap - heights) ** 2
    sums[:, 0], sums[:, 7], sums[:, 4] = moving + rest, moving, moving
    out = np.empty((len(heights), 3))
    transition = Transition(np.zeros(6), 3.0, 2.0, np.pi / breadth**2, 0.5)
    finish("lie", sums, np.zeros((len(heights), 3)), out, 1, transition)
    return out[:, 0]


def test_close_to_broad_surfaces_the_share_is_that_of_the_distance():
    """Two parabolas over the gap; by the law of curves the first cells would lose more of the motion."""
    at = np.array([1e-4, 0.01, 0.2, 0.5, 0.8, 0.99])
    parabolas = np.where(at < 0.5, 1.0 - 2.0 * at**2, 2.0 * (1.0 - at) ** 2)
    np.testing.assert_allclose(share_at(at, 1.0, 100.0), parabolas, atol=1e-3)
    assert np.all(share_at(at[:3], 1.0, 1e-6) < parabolas[:3] - 1e-6)


def test_a_membrane_is_attached_and_a_free_body_is_not():
    grid = frame(3, 2)
    free = problem_of(grid, body_specs(turning(20)))
    assert not attached(free)
    half = expression("x > 0 and abs(x) < 0.51 and abs(y) < 0.51", {"x", "y", "z"})
    body = body_specs(turning(20))[0]
    part = BoundarySpec("half", body.select, Kind.MOVING, half, turning(20))
    rest = [BoundarySpec("rest", body.select, Kind.FIXED, body.where), part]
    inner = problem_of(grid, [*rest, *body_specs(turning(20))[1:]])
    assert attached(inner)
    one = MovingShare.of(mirror_images(free), free, 4.0, 0.5)
    other = MovingShare.of(mirror_images(inner), inner, 4.0, 0.5)
    assert (one.power, one.near) == (3.0, 2.0)
    assert (other.power, other.near) == (3.0, 3.0)
