"""Triple products, and volumes and Jacobians by them."""

from ..jit import inlined


@inlined
def triple(ux, uy, uz, vx, vy, vz, wx, wy, wz):
    """u . v x w."""
    return ux * (vy * wz - vz * wy) + uy * (vz * wx - vx * wz) + uz * (vx * wy - vy * wx)


@inlined
def twelve_volumes(ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz, ex, ey, ez, fx, fy, fz):
    """Twelve times the exact volume of a trilinear hexahedron, from diagonals of its faces and itself (Grandy 1997).

    ``a b c`` lead from the corners (1, 0, 0), (0, 1, 0), (0, 0, 1) to (1, 1, 1), ``d e f`` from (0, 0, 0) to (0, 1, 1),
    (1, 0, 1), (1, 1, 0).
    """
    return (
        triple(ax + dx, ay + dy, az + dz, bx, by, bz, fx, fy, fz)
        + triple(dx, dy, dz, bx + ex, by + ey, bz + ez, cx, cy, cz)
        + triple(ax, ay, az, ex, ey, ez, cx + fx, cy + fy, cz + fz)
    )


@inlined
def along(normal, u, v):
    """Area of the parallelogram of two edges (3,), seen along a ``normal`` (3,)."""
    return (
        normal[0] * (u[1] * v[2] - u[2] * v[1])
        + normal[1] * (u[2] * v[0] - u[0] * v[2])
        + normal[2] * (u[0] * v[1] - u[1] * v[0])
    )
