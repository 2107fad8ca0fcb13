"""Repair of deformed grids: a foldover-free energy, minimised around the cells that are not sound."""

from .options import MODES, Mode, RepairOptions

__all__ = ["MODES", "Mode", "RepairOptions"]
