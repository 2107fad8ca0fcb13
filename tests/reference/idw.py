"""IDW the slow way: matrices for rotations, scipy's exponentials, one target at a time."""

import numpy as np
from scipy import integrate
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from meshdeform_core.boundary import Kind
from meshdeform_core.methods import IDW, Problem
from meshdeform_samples.reproduce.paper_methods import ReweightedIDW


def slow_idw(problem: Problem, displacement: np.ndarray, targets: np.ndarray, options: IDW) -> np.ndarray:
    x, n = problem.source_points, len(displacement)
    area = nodal_areas(problem)
    shift = area @ displacement / area.sum()
    remove = options.rotation == "lie" if options.remove_mean == "auto" else options.remove_mean
    mean = shift if remove else np.zeros(3)
    y = x + displacement - mean
    turns = [np.eye(3)] * n if options.rotation == "none" else node_rotations(problem, x, y)
    rounds = (8 if options.rotation == "lie" else 0) if options.smoothing == "auto" else options.smoothing
    if rounds and options.rotation != "none":
        turns = smoothed(problem, turns, rounds)

    def weights(at, sources):
        return weights_of(problem, at, sources, area, shift, displacement, options)

    move = _mover(x, y, turns, options)
    return np.array([move(p, weights) + mean for p in targets])


def _mover(x, y, turns, options):
    """Function of a target and the weights: its displacement."""
    if options.rotation == "none":
        return lambda p, weights: weights(p, x) @ (y - x)
    if options.rotation == "blend":
        return lambda p, weights: weights(p, x) @ (np.einsum("nij,nj->ni", turns, p - x) + y) - p
    if options.rotation == "lie":
        twists = np.array([log_motion(r, b - r @ a) for r, a, b in zip(turns, x, y, strict=True)])
        return lambda p, weights: (expm(np.einsum("n,nij->ij", weights(p, x), twists)) @ np.r_[p, 1.0])[:3] - p
    return _divided(x, y, turns, options)


def transition_width(problem, options):
    """Ends of the transition from moving sources to fixed ones, 0 without one."""
    if options.rotation != "lie" or options.weights != "luke" or on_moving_faces(problem).all():
        return 0.0
    auto = 0.3 if is_plane(problem) else 0.5
    return auto if options.transition == "auto" else options.transition


def is_plane(problem):
    """Whether a grid has at most one layer of cells along z."""
    return len(np.unique(problem.grid.points[:, 2])) <= 2


def on_moving_faces(problem):
    moving = np.zeros(len(problem.source_points), dtype=bool)
    moving[np.unique(source_quads(problem, (Kind.MOVING,)))] = True
    return moving


def distance_of(problem, weight, far):
    """The distance, up to a factor, at which a total weight (sum of area r^-far) is that of a surface or a curve."""
    touching = np.intersect1d(source_quads(problem, (Kind.MOVING,)), source_quads(problem, (Kind.FIXED,)))
    if is_plane(problem) or far <= 2.0 or touching.size:
        return weight ** (-1.0 / max(far - 1.0, 1.0))
    b = breadth(problem)
    crossing = integrate.quad(lambda r: 2 * np.pi * r * (r**2 + b**2) ** (-far / 2), 0, np.inf)[0]
    steeper = 1.0 / (far - 2.0) - 1.0 / (far - 1.0)
    return weight ** (-1.0 / (far - 1.0)) / np.hypot(1.0, weight / crossing) ** steeper


def one_body(problem):
    """Whether all moving faces are connected by common nodes."""
    first, *rest = (set(quad) for quad in source_quads(problem, (Kind.MOVING,)))
    for _ in rest:
        first = first.union(*(quad for quad in rest if quad & first))
    return all(quad <= first for quad in rest)


def breadth(problem):
    x, area = problem.source_points[on_moving_faces(problem)], nodal_areas(problem)[on_moving_faces(problem)]
    return area.sum() / (5.0 * max(np.linalg.norm(p - np.average(x, axis=0, weights=area)) for p in x))


def shared_out(problem, w, scale, far, width):
    """Weights of which the moving sources have the share of a trapezoidal slope, integrated numerically."""
    moving = on_moving_faces(problem)
    distance = [distance_of(problem, w[chosen].sum() / scale, far) for chosen in (moving, ~moving)]
    place = distance[0] / sum(distance)

    def area(to):
        corners = sorted({c for c in (width, 1.0 - width) if c < to})
        return integrate.quad(lambda t: min(t / width, (1.0 - t) / width, 1.0), 0.0, to, points=corners or None)[0]

    share = 1.0 - area(place) / area(1.0)
    return np.where(moving, w * share / w[moving].sum(), w * (1.0 - share) / w[~moving].sum())


def _divided(x, y, turns, options):
    m = options.divisions if options.rotation == "division" else 1
    parts = [Rotation.from_rotvec(Rotation.from_matrix(r).as_rotvec() / m) for r in turns]
    shifts = [
        np.linalg.solve(sum(np.linalg.matrix_power(q.as_matrix(), i) for i in range(m)), b - r @ a)
        for q, r, a, b in zip(parts, turns, x, y, strict=True)
    ]
    quaternions = np.array([q.as_quat(scalar_first=True) for q in parts])
    quaternions[quaternions[:, 0] < 0] *= -1
    path = [x]
    for _ in range(m - 1):
        path.append(np.array([q.apply(s) + t for q, s, t in zip(parts, path[-1], shifts, strict=True)]))

    def move(p, weights):
        at = p.copy()
        w = weights(p, x)
        for sources in path:
            w = weights(at, sources) if isinstance(options, ReweightedIDW) else w
            q = w @ quaternions
            at = Rotation.from_quat(q / np.linalg.norm(q), scalar_first=True).apply(at) + w @ np.array(shifts)
        return at - p

    return move


def weights_of(problem, p, x, area, shift, displacement, options):
    r = np.linalg.norm(p - x, axis=1)
    length = options.length
    if length == "auto":
        t = problem.topology
        unique = np.setdiff1d(np.arange(problem.grid.n_nodes), np.setdiff1d(t.face_nodes, t.first))
        center = problem.grid.points[unique].mean(axis=0)
        length = np.linalg.norm(problem.source_points - center, axis=1).max()
    if options.weights == "shepard":
        moving = problem.boundary.kind[problem.source_numbers] == Kind.MOVING
        w = (length / r) ** np.where(moving, options.p_moving, options.p_fixed)
    else:
        alpha = options.alpha
        if alpha == "auto":
            alpha = min(0.3, options.eta / length * np.linalg.norm(displacement - shift, axis=1).max())
        far, width = options.a, transition_width(problem, options)
        if far == "auto" and width and one_body(problem):
            far = 4.0
        elif far == "auto":
            far = 2.5 if is_plane(problem) and options.rotation == "lie" else 3.0
        w = area * ((length / r) ** far + (alpha * length / r) ** options.b)
        if width:
            return shared_out(problem, w, length**far, far, width)
    return w / w.sum()


def log_motion(turn, translation):
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = turn, translation
    # Of translations, as of all sources at rest, the series of the logarithm ends at once.
    return motion - np.eye(4) if np.array_equal(turn, np.eye(3)) else np.real(logm(motion))


def source_quads(problem, kinds):
    number = {int(u): i for i, u in enumerate(problem.source_numbers)}
    chosen = np.isin(problem.boundary.quad_kind, kinds)
    return [[number[int(c)] for c in quad] for quad in problem.topology.quads.corners[chosen]]


def nodal_areas(problem):
    area = np.zeros(len(problem.source_points))
    for face in source_quads(problem, (Kind.MOVING, Kind.FIXED)):
        corners = problem.source_points[face]
        if len(face) == 2:
            size = np.linalg.norm(corners[1] - corners[0])
        else:
            size = 0.5 * np.linalg.norm(np.cross(corners[2] - corners[0], corners[3] - corners[1]))
        area[face] += size / len(face)
    return area


def node_rotations(problem, x, y):
    """Appendix A of the paper for every source that belongs to a moving face."""
    quads = source_quads(problem, (Kind.MOVING,))
    turns = []
    for node in range(len(x)):
        mine = [quad for quad in quads if node in quad]
        turns.append(_node_rotation(problem, node, mine, x, y) if mine else np.eye(3))
    return turns


def _node_rotation(problem, node, quads, x, y):
    if problem.grid.dimension == 2:
        before, after = (_unit(sum(_unit(p[b] - p[a]) for a, b in quads)) for p in (x, y))
        angle = np.arctan2(np.cross(before, after)[2], before @ after)
        return Rotation.from_rotvec([0, 0, angle]).as_matrix()
    normals = [_unit(sum(_corner_normal(p, node, quad) for quad in quads)) for p in (x, y)]
    first = _between(*normals)
    neighbours = set()
    for quad in quads:
        at = quad.index(node)
        neighbours |= {quad[(at + 1) % 4], quad[at - 1]}
    angles, weights = [], []
    for other in neighbours:
        arm, target = (_unit(v) for v in (first @ (x[other] - x[node]), y[other] - y[node]))
        arm, target = (v - normals[1] * (normals[1] @ v) for v in (arm, target))
        angles.append(np.arctan2(normals[1] @ np.cross(arm, target), arm @ target))
        # Edges steeper than 45 degrees count less.
        part = min(1.0, 4.0 * (arm @ arm) * (target @ target))
        weights.append(10.0 * part**3 - 15.0 * part**4 + 6.0 * part**5)
    return Rotation.from_rotvec(normals[1] * np.average(angles, weights=weights)).as_matrix() @ first


def smoothed(problem, turns, rounds):
    """Nodes within ``rounds`` edges of a sharp one take half of their neighbours' mean quaternion, ``rounds`` times."""
    x, quads = problem.source_points, source_quads(problem, (Kind.MOVING,))
    around = {node: set() for quad in quads for node in quad}
    for quad in quads:
        for a, b in zip(quad, quad[1:] + quad[:1], strict=True):
            around[a] |= {b} - {a}
            around[b] |= {a} - {b}

    def is_sharp(node):
        normals = [_normal_at(problem, x, node, quad) for quad in quads if node in quad]
        return np.linalg.norm(np.mean(normals, axis=0)) < 0.9

    near = {node for node in around if is_sharp(node)}
    for _ in range(rounds):
        near |= {other for node in near for other in around[node]}
    q = Rotation.from_matrix(turns).as_quat(canonical=True)
    for _ in range(rounds):
        new = q.copy()
        for node in near:
            others = [q[o] if q[o] @ q[node] >= 0 else -q[o] for o in around[node]]
            new[node] = _unit(q[node] + np.mean(others, axis=0))
        q = new
    return list(Rotation.from_quat(q).as_matrix())


def _normal_at(problem, x, node, quad):
    if problem.grid.dimension == 2:
        return np.cross(_unit(x[quad[1]] - x[quad[0]]), [0.0, 0.0, 1.0])
    return _corner_normal(x, node, quad)


def _corner_normal(p, node, quad):
    at = quad.index(node)
    return _unit(np.cross(p[quad[(at + 1) % 4]] - p[node], p[quad[at - 1]] - p[node]))


def _between(a, b):
    axis = np.cross(a, b)
    angle = np.arctan2(np.linalg.norm(axis), a @ b)
    return Rotation.from_rotvec(angle * _unit(axis)).as_matrix()


def _unit(v):
    length = np.linalg.norm(v)
    return v / length if length > 0 else v
