"""The options of ``meshdeform series`` about its levels, packed into one record."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click

from meshdeform_core.memory import SWEPT_BYTES, VELOCITY_BYTES

from .options import PATH, packed, steps_option


@dataclass(frozen=True)
class SeriesInput:
    """Output folder, times, mode and format of the levels."""

    output: Path
    times: str | None
    origin: str
    steps: int | str | None
    velocity: str
    suffix: str | None
    single_file: bool
    resume: bool

    @property
    def velocity_bytes(self) -> int:
        """Bytes per node that the velocities take in memory."""
        return VELOCITY_BYTES * (self.velocity != "none") + SWEPT_BYTES * (self.velocity == "swept")


series_options = packed(
    SeriesInput,
    "wanted",
    click.option("-o", "--output", type=PATH, required=True, help="Folder for the levels; created if missing."),
    click.option(
        "--times", metavar="START:STOP:STEP",
        help="Time levels, or a list a,b,c; by default those of the case's sequence of displacement files.",
    ),
    click.option(
        "--from", "origin", type=click.Choice(("reference", "last")), default="reference", show_default=True,
        help="Make each level from the undeformed grid, or from the previous level (marching).",
    ),
    steps_option("each level"),
    click.option(
        "--velocity", type=click.Choice(("none", "first", "second", "swept")), default="none", show_default=True,
        help="Write the grid velocity, by backward differences of this order, or the volumes swept by the cell faces "
        "as well (VTK and CGNS).",
    ),
    click.option("--suffix", help="Format of the levels, by suffix (default: that of GRID)."),
    click.option("--single-file", is_flag=True, help="All levels in one CGNS file."),
    click.option("--resume", is_flag=True, help="Continue an interrupted run of the same series."),
)  # fmt: skip
