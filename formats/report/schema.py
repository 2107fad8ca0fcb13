"""The JSON schema of reports, made of the types of what they hold: the core's records, and the parts added here."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NotRequired, Required, TypedDict

import msgspec
from msgspec import Meta

from meshdeform_core.mending import Renewal
from meshdeform_core.methods.limits import PatchMotion
from meshdeform_core.quality.listed import InvalidCell, InvalidGroup
from meshdeform_core.quality.report import BlockSkew, Quality
from meshdeform_core.quality.shape import FacePyramids, ShapeMeasure
from meshdeform_core.quality.walls import LayerChange
from meshdeform_core.repair.outcome import Repair
from meshdeform_core.setup import Attempt

from .tables import DEFINITIONS

_MISSING = object()
Count = Annotated[int, Meta(ge=0)]
Seconds = Annotated[dict[str, float], Meta(description="seconds by stage; they add up to total")]


def _told(text: str) -> Meta:
    return Meta(description=text)


class GridPart(TypedDict):
    """The grid"""

    file: str | None
    format: str | None
    dimension: Literal[2, 3]
    blocks: Count
    nodes: Count
    cells: Count


class SettingPart(TypedDict):
    """A parameter as used, and why"""

    value: Annotated[Any, _told("number, text, truth value or list")]
    reason: NotRequired[str]


MethodPart = Annotated[dict[str, str | SettingPart], _told("name, and every parameter with its value")]


class BoundaryEntry(TypedDict):
    """A boundary entry"""

    name: str
    kind: str
    nodes: Count


class MatchPart(TypedDict):
    """How a displacement table was used"""

    table: str
    match: Literal["exact", "nearest", "interpolate"]
    matched_nodes: Count
    unmatched_nodes: Count
    table_points: Count
    table_points_used: Count
    max_distance: float
    max_extrapolation: float
    walls: Annotated[list[str], _told("surfaces that the table was found to fit, where the case does not say which")]
    size_ratio: float | None


class BoundaryPart(TypedDict):
    """Unique nodes of the faces by kind"""

    patches: list[BoundaryEntry]
    moving_nodes: Count
    fixed_nodes: Count
    slip_nodes: Annotated[Count, _told("slip and symmetry")]
    interface_nodes: Annotated[Count, _told("all others on block faces")]
    interior_nodes: Count
    max_displacement: NotRequired[float]
    matches: NotRequired[list[MatchPart]]


class QualityPart(TypedDict):
    """Before and after; change is after minus before"""

    before: Quality
    after: NotRequired[Quality]
    change: NotRequired[dict[str, Any]]


class BlockEntry(TypedDict):
    """One block"""

    name: str
    families: Annotated[list[str], _told("families of the patches on it, or the patches without one")]
    cells: Count
    invalid_cells: Count
    before: BlockSkew
    after: BlockSkew


class OutcomePart(TypedDict):
    """How a deformation ended"""

    valid: Annotated[bool, _told("the whole motion was imposed and no cell became invalid")]
    steps: Count
    reached: Annotated[float, Meta(ge=0, le=1), _told("fraction of the motion that was imposed")]
    attempts: Annotated[list[Attempt], _told("what was tried until the grid was valid")]
    repair: Annotated[Repair | None, _told("null when nothing was repaired")]


class ComponentOutcome(OutcomePart):
    """A component at a level"""

    name: str
    invalid_cells: Count


class ComponentPart(ComponentOutcome):
    """A component of an overset grid, moved by its own boundary"""

    blocks: list[str]
    nodes: Count
    cells: Count
    moving_nodes: Count
    max_displacement: float
    quality: QualityPart


class RepairedLayers(TypedDict):
    """What the repair changed in the first layers of cells at the walls"""

    moving: LayerChange | None
    fixed: LayerChange | None


class LevelSmoothness(TypedDict):
    """Largest node velocity and acceleration, times the interval and its square, relative to the largest step of the
    walls, and the acceleration relative to the local edge"""

    velocity: float | None
    acceleration: float | None
    acceleration_in_edges: float | None


class LevelPart(OutcomePart):
    """One time level"""

    number: Count
    time: float
    file: Annotated[str, _told("in the folder of the series")]
    max_displacement: float
    max_rotation_deg: float
    motion: list[PatchMotion]
    smoothness: LevelSmoothness
    components: NotRequired[list[ComponentOutcome]]
    quality: Quality
    invalid_cells: Annotated[list[InvalidCell], _told("at most 20")]
    invalid_groups: list[InvalidGroup]
    method: Annotated[dict[str, SettingPart], _told("parameters that differ from those of the series")]
    timing: Seconds
    warnings: Annotated[list[str], _told("those that no earlier level gave")]


class SeriesPart(TypedDict):
    """A series"""

    levels: Count
    velocity: Literal["none", "first", "second", "swept"]
    folder: str
    view: Annotated[str | None, _told("to open in ParaView")]


class ShapeMeasures(TypedDict, total=False):
    """What flow solvers complain about, and the cell where it is worst; measures that no cell has are absent"""

    aspect_ratio: ShapeMeasure
    growth_ratio: ShapeMeasure
    non_orthogonality_deg: ShapeMeasure
    skewness: ShapeMeasure
    face_pyramids: FacePyramids


class ShapePart(TypedDict):
    """What flow solvers complain about, before and after"""

    before: ShapeMeasures | None
    after: ShapeMeasures


class ExpectedPart(TypedDict):
    """What one step without a repair takes, at every level; memory on each of the ranks that hold a part of the grid,
    everything else for all of them together"""

    ranks: Count
    memory_bytes: Count
    work_bytes: Count
    output_bytes: Count


class RunFile(TypedDict):
    """A file that was read or written"""

    role: str
    path: str
    bytes: Count
    sha256: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]


class RunPart(TypedDict):
    """How the report came about"""

    command: Annotated[str, _told("to repeat it")]
    directory: str
    date: Annotated[str, _told("UTC")]
    threads: Count
    ranks: Count
    versions: dict[str, str]
    files: list[RunFile]


class ReportForm(OutcomePart, total=False):
    """What --report FILE.json writes: of a deformation, a series (levels), a quality check, or a dry run. Keys may be
    added within version 1; none changes its meaning."""

    schema: Required[Literal[1]]
    meshdeform: Required[Annotated[str, _told("version of the program")]]
    grid: Required[GridPart]
    warnings: Required[list[str]]
    reference: Annotated[str | None, _told("quality: the original grid")]
    method: MethodPart
    boundary: BoundaryPart
    motion: list[PatchMotion]
    quality: QualityPart
    shape: Annotated[ShapePart, _told("of a quality check")]
    blocks: list[BlockEntry]
    invalid_cells: Annotated[list[InvalidCell], _told("at most 200")]
    invalid_groups: Annotated[list[InvalidGroup], _told("by place, the largest first, at most 20")]
    repaired_layers: Annotated[RepairedLayers | None, _told("null where nothing was repaired")]
    components: list[ComponentPart]
    new_interior: Annotated[Renewal | None, _told("of a repair: how the interior was remade")]
    timing: Seconds
    peak_memory_bytes: Count
    expected: Annotated[ExpectedPart, _told("of a dry run on a large grid")]
    series: SeriesPart
    levels: list[LevelPart]
    run: RunPart
    output: Annotated[str | None, _told("the grid as written: beside the name asked for if invalid")]


def report_schema() -> dict[str, Any]:
    """The schema (draft 2020-12) of the output of ``--report FILE.json``, as data."""
    definitions = msgspec.json.schema(ReportForm)["$defs"]
    for definition in definitions.values():
        always, properties = set(definition["required"]), definition["properties"]
        if definition["title"] == "ReportForm":
            # Reports of quality checks and dry runs have no outcome.
            always -= set(OutcomePart.__annotations__)
        # Records of the core are written with all their fields, those that have a default, too.
        always |= {name for name, kind in properties.items() if kind.pop("default", _MISSING) is not _MISSING}
        definition["required"] = [name for name in properties if name in always]
        definition["additionalProperties"] = False
        definition["description"] = " ".join(definition["description"].split())
    for name, text in DEFINITIONS.items():
        definitions["Quality"]["properties"].get(name, {})["description"] = text
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": "urn:meshdeform:report:1",
        **definitions.pop("ReportForm"),
        "title": "meshdeform report",
        "$defs": definitions,
    }
