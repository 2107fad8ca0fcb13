"""Started by test_mpi.py under mpiexec: the components' products on all ranks against one process alone.

OpenMDAO's own distributed vectors need PETSc; here the components are given this rank's pieces directly.
"""

import numpy as np
import openmdao.api as om
from api.test_openmdao import bent, prepared
from mpi4py import MPI

from meshdeform.openmdao import MeshCoordinates, MeshDeformBuilder, MeshDeformComp, MeshQualityComp


def component(kind, comm, **options):
    """A component that has been set up on a communicator, without a problem."""
    part = kind(**options)
    part.comm = comm
    part.setup()
    return part


def products(comm, mesh):
    """Volume, forward and reverse products and quality, pieces of all ranks together."""
    deform, quality = (component(kind, comm, mesh=mesh) for kind in (MeshDeformComp, MeshQualityComp))
    own, nodes = deform.own_points, deform.own_nodes
    at = {"x_aero": bent(mesh.points)[own].ravel()}
    volume, pushed, pulled = {}, {"x_aero_volume": 0.0}, {"x_aero": 0.0}
    deform.compute(at, volume)
    change = {"x_aero": np.cos(5.0 * mesh.points[own]).ravel()}
    deform.compute_jacvec_product(at, change, pushed, "fwd")
    seed = {"x_aero_volume": np.cos(3.0 * np.arange(3 * mesh.grid.n_nodes)).reshape(-1, 3)[nodes].ravel()}
    deform.compute_jacvec_product(at, pulled, seed, "rev")
    measured, slope, gradient = {}, {"quality_scaled_jacobian_min": 0.0}, {"x_aero_volume": 0.0}
    quality.compute(volume, measured)
    quality.compute_jacvec_product(volume, pushed, slope, "fwd")
    one = {"quality_scaled_jacobian_min": np.array([1.0 / comm.size])}
    quality.compute_jacvec_product(volume, gradient, one, "rev")
    pieces = volume["x_aero_volume"], pushed["x_aero_volume"], pulled["x_aero"], gradient["x_aero_volume"]
    together = [np.concatenate(comm.allgather(piece)) for piece in pieces]
    return [*together, np.array([*measured.values(), *slope.values()]).ravel()]


def main(comm):
    shared, alone = prepared(comm), prepared()
    for one, two in zip(products(comm, shared), products(MPI.COMM_SELF, alone), strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-11, atol=1e-13)
    builder = MeshDeformBuilder(prepared)
    builder.initialize(comm)
    assert comm.allreduce(builder.get_number_of_nodes()) == len(alone.points)
    assert builder.get_tagged_indices(["body"]) == list(range(builder.get_number_of_nodes()))
    coordinates = component(MeshCoordinates, comm, mesh=shared)
    pieces = comm.allgather(coordinates.mphys_get_surface_mesh())
    np.testing.assert_array_equal(np.concatenate(pieces), alone.points.ravel())
    deform, failures = component(MeshDeformComp, comm, mesh=shared), []
    try:
        deform.compute({"x_aero": (shared.points * [-1.0, 1.0, 1.0])[deform.own_points].ravel()}, {})
    except om.AnalysisError as failure:
        failures.append(str(failure))
    assert len(comm.allgather(failures)[0]) == comm.allreduce(len(failures)) / comm.size == 1
    print(f"rank {comm.rank} of {comm.size} agrees")


if __name__ == "__main__":
    main(MPI.COMM_WORLD)
