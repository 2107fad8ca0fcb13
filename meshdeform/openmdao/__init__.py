"""Grid deformation in OpenMDAO models and MPhys scenarios; needs the extra ``openmdao``.

    import openmdao.api as om
    from meshdeform.openmdao import MeshDeformComp

    problem.model.add_subsystem("deform", MeshDeformComp(mesh=md.prepare("wing.cgns", moving=["wing"])))

Surface and volume coordinates are flat vectors, distributed if there are several ranks. Rank r of P holds the rows
int(n r / P) to int(n (r + 1) / P) of ``mesh.points``, and of the nodes of all blocks in block order, C order within a
block.
"""

from .builder import MeshDeformBuilder
from .components import MeshCoordinates, MeshDeformComp, MeshQualityComp

__all__ = ["MeshCoordinates", "MeshDeformBuilder", "MeshDeformComp", "MeshQualityComp"]
