"""Large motions of the samples and of third-party grids, each as one step, for comparing the methods."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from flows import SAMPLES, grids_folder

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.boundary.motions.motion import Displace, Motion, Rotate
from meshdeform_core.deform import Case, Setup, set_up
from meshdeform_core.grid import FloatArray
from meshdeform_formats.grids import read_grid
from meshdeform_samples.reproduce.experiment import Sample, prepare_sample

SPAN = 12.09152937
"""Of the wing in 717_wl_L2.cgns, along z; its chord is 10."""


@dataclass(frozen=True)
class Job:
    """A set-up case and the displacement (n_sources, 3) of its boundary; ``file`` is the third-party grid it needs."""

    label: str
    make: Callable[[], tuple[Setup, FloatArray]]
    file: str = ""

    @property
    def possible(self) -> bool:
        """Whether its grid is here."""
        return not self.file or (grids_folder() / self.file).is_file()


def _sample(name: str, label: str, time: float = 0.0, scale: float = 1.0, **constants: float) -> Job:
    def make() -> tuple[Setup, FloatArray]:
        setup = prepare_sample(Sample(name, SAMPLES[name], constants=tuple(constants.items())))
        return setup, scale * setup.displacement(time)[setup.problem.source_numbers]

    return Job(f"{name}, {label}", make)


def _third_party(file: str, label: str, motion: Motion, walls: str, slip: str = "") -> Job:
    def make() -> tuple[Setup, FloatArray]:
        specs = [BoundarySpec("wall", tuple(walls.split()), Kind.MOVING, None, motion)]
        specs += [BoundarySpec("slip", (slip,), Kind.SYMMETRY if slip == "Sym" else Kind.SLIP)] if slip else []
        setup = set_up(read_grid(grids_folder() / file), Case(tuple(specs)))
        return setup, setup.displacement(0.0)[setup.problem.source_numbers]

    return Job(f"{file}, {label}", make, file)


def rotate(angle: str, axis: tuple[float, float, float], *center: float) -> Rotate:
    """By ``angle`` degrees, a formula of x, y and z, about a line."""
    x, y, z = (expression(float(c), ()) for c in center)
    return Rotate(expression(angle, {"x", "y", "z"}), axis, (x, y, z))


def displace(*parts: str) -> Displace:
    """By three formulas of x, y and z."""
    x, y, z = (expression(part, {"x", "y", "z"}) for part in parts)
    return Displace((x, y, z))


def _bent_wing(twist: float, bend: float) -> Motion:
    turn = rotate(f"{twist} * z / {SPAN}", (0, 0, 1), 0, 0, 0)
    return Motion((turn, displace("0", f"{bend * SPAN} * (z / {SPAN})**2", "0")), {})


def _wing(label: str, motion: Motion) -> Job:
    return _third_party("717_wl_L2.cgns", label, motion, "wall", "Sym")


_SQUEEZED = Motion((displace("1.25", "0", "0"),), {})
_BUMP = Motion((displace("0", "0", "4.5*where(abs(x - 4) < 4, cos(pi*(x - 4)/8)**2, 0)"),), {})
_TURNED = Motion((rotate("60", (0, 0, 1), 0, 0, 0),), {})
_SHIFTED = Motion((displace("0.75", "0", "0"),), {})
_LOWERED = Motion((displace("0", "0", "-4.5*exp(-((x - 4)/8)**2)"),), {})
_ANGLES = (15.0, 30.0, 35.0, 45.0)
JOBS: tuple[Job, ...] = (
    *(_sample("splitter-plate", f"{angle:g} degrees", angle=angle) for angle in _ANGLES),
    *(_sample("valve", f"{angle:g} degrees", time=0.1, opening=angle) for angle in (25.0, 35.0)),
    *(_sample("cascade", f"{angle:g} degrees", angle=angle) for angle in (25.0, 45.0)),
    *(_sample("hemisphere", f"amplitude {a:g}", time=2.5e-4, amplitude=a) for a in (0.011, 0.033)),
    *(_sample("beam", f"times {scale:g}", scale=scale) for scale in (1.0, 2.0)),
    _sample("square", "as it is"),
    *(_sample("wing", f"times {scale:g}", scale=scale) for scale in (1.0, 3.0)),
    _wing("twist -15, bend 25 %", _bent_wing(-15.0, 0.25)),
    _wing("twist 15, bend 25 %", _bent_wing(15.0, 0.25)),
    _wing("bend 50 %", _bent_wing(0.0, 0.5)),
    _wing("pitch 30 degrees", Motion((rotate("30", (0, 0, 1), 2.5, 0, 0),), {})),
    _third_party("nak_a_141.cgns", "pitch 45 degrees", Motion((rotate("45", (0, 1, 0), 0.25, 0, 0),), {}), "Klo_Seg*"),
    _third_party("cylinder_ring_4blk.x", "turned 60 degrees", _TURNED, "*.jmax", "*.k*"),
    _third_party("cylinder_ring_4blk.x", "shifted by 1.5 radii", _SHIFTED, "*.jmax", "*.k*"),
    _third_party("cylinder_ring_4blk.x", "squeezed to a half", _SQUEEZED, "*.jmax", "*.k*"),
    _third_party("backstep5_4levdn.p3dbin", "bump of 4.5", _BUMP, "block3.kmin block4.kmin"),
    _third_party("backstep5_4levdn.p3dbin", "roof down to a half", _LOWERED, "*.kmax"),
)
"""In the order of the table."""
