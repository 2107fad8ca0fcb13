"""A flow bends a flap, with implicit iterations through preCICE's interface: ``python examples/flap.py``.

With pyprecice 3, ``python examples/flap.py CONFIG.xml`` is the participant ``Fluid`` of any coupling with a flap. It
has the 2-D mesh ``Fluid-Mesh``, writes the vectors ``Force`` and reads ``Displacement``. This is not tested with
preCICE itself. The flow is a stand-in.
"""

import sys

import numpy as np

import meshdeform as md


class Beam:
    """A beam clamped at x = -0.5, in its first mode, behind the part of ``precice.Participant`` that the flow uses."""

    time, start, state, converged = 0.0, np.zeros(2), np.zeros(2), True

    def set_mesh_vertices(self, mesh, positions):
        self.shape = (positions[:, 0] + 0.5) ** 2
        return np.arange(len(positions))

    def initialize(self): ...

    finalize = initialize

    def is_coupling_ongoing(self):
        return self.time < 0.299

    def get_max_time_step_size(self):
        return 0.1

    def requires_writing_checkpoint(self):
        return self.converged

    def requires_reading_checkpoint(self):
        return not self.converged

    def read_data(self, mesh, name, ids, relative_time):
        return np.outer(self.state[0] * self.shape, [0.0, 1.0])

    def write_data(self, mesh, name, ids, values):
        self.load = np.array([0.0, 10.0 * self.shape @ values[:, 1]])

    def advance(self, dt):
        """An iteration: deflection and its rate by the trapezoidal rule."""
        half, before = 0.5 * dt * np.array([[0.0, 1.0], [-30.0, 0.0]]), self.state[0]
        self.state = np.linalg.solve(np.eye(2) - half, self.start + half @ self.start + dt * self.load)
        self.converged = abs(self.state[0] - before) < 1e-9
        if self.converged:
            self.time, self.start = self.time + dt, self.state


def flow(coupling):
    """Displacement and grid of every iteration; each grid is made from the undeformed one."""
    mesh = md.prepare(md.sample("beam", 40).grid, moving=["beam"], fixed=["outer"])
    x, time = mesh.points[:, 0], 0.0
    ids = coupling.set_mesh_vertices("Fluid-Mesh", mesh.points[:, :2])
    coupling.initialize()
    while coupling.is_coupling_ongoing():
        if coupling.requires_writing_checkpoint():
            saved = time
        dt = coupling.get_max_time_step_size()
        displacement = np.pad(coupling.read_data("Fluid-Mesh", "Displacement", ids, dt), ((0, 0), (0, 1)))
        step, time = mesh.deform(displacement), time + dt
        yield displacement, step
        # Bernoulli's pressures in the gaps below and above the flap, and a gust.
        below, above = (np.ptp(step.grid.blocks[b][..., 1], axis=1).ravel() for b in (3, 4))
        lift = 0.5 * (above**-2.0 - below**-2.0) + np.sin(np.pi * time)
        force = np.interp(x, mesh.grid.blocks[3][:, 0, ..., 0].ravel(), lift) / len(x)
        coupling.write_data("Fluid-Mesh", "Force", ids, np.stack([0.0 * x, force], axis=1))
        coupling.advance(dt)
        if coupling.requires_reading_checkpoint():
            time = saved
    coupling.finalize()


if __name__ == "__main__":
    coupling = Beam()
    if sys.argv[1:]:
        from precice import Participant

        coupling = Participant("Fluid", sys.argv[1], 0, 1)
    for number, (moved, step) in enumerate(flow(coupling)):
        print(f"iteration {number}: tip at {moved[:, 1].max():.9f}, {step}")
