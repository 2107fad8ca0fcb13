"""Components of overset grids: each is deformed exactly as if it were alone."""

import dataclasses

import numpy as np
import pytest
from cases import ALL_METHODS, STILL, constant, turning
from grids import block_around, frame, interleaved, polar

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.deform import Case, deform, set_up
from meshdeform_core.errors import CaseError
from meshdeform_core.grid import Grid
from meshdeform_core.grid.openings import find_openings
from meshdeform_core.grid.selection import BY_PREFIX, with_components
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.methods import Options
from meshdeform_core.repair import RepairOptions
from meshdeform_core.series import Schedule, deform_series

NEAR = expression("abs(x) < 0.51 and abs(y) < 0.51", {"x", "y", "z"})
FAR = expression("max(abs(x), abs(y)) > 1.99", {"x", "y", "z"})


def background() -> Grid:
    x = np.linspace(-5.0, 5.0, 14)
    return Grid.from_blocks(
        [block_around(x[:8], x, np.linspace(0, 1, 4)), block_around(x[7:], x, np.linspace(0, 1, 4))]
    )


def ring() -> Grid:
    grid = polar(16, 5, 3)
    return grid.moved(grid.points + [1.5, 0.7, 0.0])


def alone(whole: Grid, name: str) -> Grid:
    own = [n for n, block in enumerate(whole.names) if block.startswith(f"{name}.")]
    return Grid.from_blocks([whole.block(n) for n in own], [whole.names[n] for n in own])


def part_of(whole: Grid, name: str, values: np.ndarray | None = None) -> np.ndarray:
    own = [n for n, block in enumerate(whole.names) if block.startswith(f"{name}.")]
    return np.concatenate([whole.block(n, values).reshape(-1, 3) for n in own])


GRID = interleaved(bg=background(), bar=frame(3, 2), ring=ring())
BAR = (
    BoundarySpec("bar", ("bar.*.*",), Kind.MOVING, NEAR, turning(12.0)),
    BoundarySpec("bar far", ("bar.*.i*", "bar.*.j*"), Kind.FIXED, FAR),
    BoundarySpec("bar span", ("bar.*.k*",), Kind.SLIP),
)
RING = (
    BoundarySpec("ring", ("ring.*.jmin",), Kind.MOVING, None, turning(20.0, center=(1.5, 0.7, 0.0))),
    BoundarySpec("ring far", ("ring.*.jmax",), Kind.FREE),
    BoundarySpec("ring span", ("ring.*.k*",), Kind.SYMMETRY),
)
FIXED = (BoundarySpec("bg", ("bg.*.*",), Kind.FIXED),)


def case(specs: tuple[BoundarySpec, ...], method: Options | None = None, components: str = "", **repair) -> Case:
    return Case(specs, method=method or Options(), components=components, repair=RepairOptions(**repair))


@pytest.mark.parametrize("name", ["idw-tfi", "rbf-tps", "tfi"])
def test_every_component_moves_as_if_it_were_alone(name):
    whole = deform(GRID, case(BAR + RING + FIXED, ALL_METHODS[name], BY_PREFIX))
    for own, specs in (("bar", BAR), ("ring", RING)):
        single = deform(alone(GRID, own), case(specs, ALL_METHODS[name]))
        np.testing.assert_array_equal(part_of(whole.grid, own), single.grid.points)
        result = dict(whole.components)[own]
        assert (result.steps, result.valid) == (single.steps, single.valid)
        assert result.assessment.after == single.assessment.after
    np.testing.assert_array_equal(part_of(whole.grid, "bg"), part_of(GRID, "bg"))


def test_repairs_and_steps_are_those_of_each_component():
    far = tuple(dataclasses.replace(spec, motion=turning(75.0)) if spec.name == "bar" else spec for spec in BAR)
    whole = deform(GRID, case(far + RING + FIXED, components=BY_PREFIX))
    single = deform(alone(GRID, "bar"), case(far))
    np.testing.assert_array_equal(part_of(whole.grid, "bar"), single.grid.points)
    results = dict(whole.components)
    assert results["bar"].attempts == single.attempts
    assert whole.repair is not None
    assert whole.repair.nodes == single.repair.nodes
    assert results["ring"].repair is None
    # A component with free outer faces moves rigidly with its wall.
    start, t = part_of(GRID, "ring") - [1.5, 0.7, 0.0], np.radians(20.0)
    turn = np.array([[np.cos(t), -np.sin(t), 0.0], [np.sin(t), np.cos(t), 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(part_of(whole.grid, "ring"), start @ turn.T + [1.5, 0.7, 0.0], atol=1e-13)


def test_as_much_of_the_motion_is_reached_as_the_component_that_fails_reaches():
    far = tuple(dataclasses.replace(spec, motion=turning(150.0)) if spec.name == "bar" else spec for spec in BAR)
    whole = deform(GRID, case(far + RING + FIXED, Options("tfi"), BY_PREFIX, mode="off"), steps="auto")
    own = dict(whole.components)
    assert own["bar"].reached < own["ring"].reached == 1.0
    assert (whole.reached, whole.steps) == (own["bar"].reached, own["bar"].steps)


def test_invalid_cells_are_listed_with_the_walls_of_their_own_component_and_the_worst_first():
    """The ring comes after the bar, and has the worst cell."""
    turned = {"bar": turning(75.0), "ring": turning(150.0, center=(1.5, 0.7, 0.0))}
    specs = [dataclasses.replace(s, motion=turned[s.name]) if s.name in turned else s for s in BAR]
    ring = [BoundarySpec("ring", ("ring.*.jmin",), Kind.MOVING, None, turned["ring"])]
    ring.append(BoundarySpec("ring far", ("ring.*.jmax",), Kind.FIXED))
    result = deform(GRID, case((*specs, *ring, RING[2], *FIXED), components=BY_PREFIX, mode="off"))
    worst = result.assessment.after.worst["min_relative_jacobian"]
    listed = result.assessment.invalid
    assert {(cell.block.split(".")[0], cell.nearest_patch) for cell in listed} == {("bar", "bar"), ("ring", "ring")}
    assert [name for name, own in result.components if not own.valid] == ["bar", "ring"]
    assert len(listed) == result.assessment.after.invalid_cells
    assert worst.block.startswith("ring")
    assert (listed[0].block, listed[0].ijk) == (worst.block, worst.ijk)


def test_components_may_pass_through_each_other_but_not_through_themselves():
    free = (BoundarySpec("far", ("bar.*.i*", "bar.*.j*"), Kind.FREE, FAR), BAR[2])
    shift = BoundarySpec("bar", ("bar.*.*",), Kind.MOVING, NEAR, constant(1.4, 0.6, 0.0))
    through = deform(GRID, case((shift, *free, *RING, *FIXED), components=BY_PREFIX))
    assert through.valid
    assert not [text for text in through.warnings if "crosses" in text]
    out = dataclasses.replace(shift, motion=constant(2.5, 0.0, 0.0))
    setup = set_up(GRID, case((out, BAR[1], BAR[2], *RING, *FIXED), components=BY_PREFIX))
    contact = setup.undeformed.contact(setup.motion(0.0))
    assert contact is not None
    assert {name for crossing in contact.crossings for name in crossing.patches} <= {"bar", "bar far"}
    # The ring, which comes later, meets itself earlier.
    both = (dataclasses.replace(RING[0], motion=constant(5.0, 0.0, 0.0)), dataclasses.replace(RING[1], kind=Kind.FIXED))
    setup = set_up(GRID, case((out, *BAR[1:], *both, RING[2], *FIXED), components=BY_PREFIX))
    earlier = setup.undeformed.contact(setup.motion(0.0))
    assert earlier.fraction < contact.fraction
    assert {name for crossing in earlier.crossings for name in crossing.patches} <= {"ring", "ring far"}


def test_nodes_at_one_place_belong_to_one_component_only():
    """A ring whose wall has the nodes of the bar's wall keeps them to itself."""
    twice = interleaved(bar=frame(3, 2), copy=frame(3, 2))
    other = tuple(dataclasses.replace(s, name=f"c {s.name}", select=tuple(p.replace("bar", "copy") for p in s.select))
                  for s in BAR)  # fmt: skip
    still = (dataclasses.replace(other[0], motion=STILL), *other[1:])
    result = deform(twice, case(BAR + still, components=BY_PREFIX))
    np.testing.assert_array_equal(part_of(result.grid, "copy"), part_of(twice, "copy"))
    np.testing.assert_array_equal(part_of(result.grid, "bar"), deform(alone(twice, "bar"), case(BAR)).grid.points)


def test_openings_and_overlaps_are_sought_within_components():
    named = with_components(GRID, BY_PREFIX)
    assert find_openings(GRID, find_topology(GRID))
    assert not find_openings(named, find_topology(named))


def test_levels_of_a_series_are_those_of_each_component():
    moving = tuple(dataclasses.replace(s, motion=turning("12*t")) if s.name == "bar" else s for s in BAR)
    schedule = Schedule((0.5, 1.0), velocity="first")
    levels = list(deform_series(set_up(GRID, case(moving + RING + FIXED, components=BY_PREFIX)), schedule, "float64"))
    single = list(deform_series(set_up(alone(GRID, "bar"), case(moving)), schedule, "float64"))
    for whole, own in zip(levels, single, strict=True):
        np.testing.assert_array_equal(part_of(whole.result.grid, "bar"), own.result.grid.points)
        np.testing.assert_array_equal(part_of(GRID, "bar", whole.velocity), own.velocity)


@pytest.mark.parametrize(
    ("components", "message"),
    [
        ({"bar": ["bar.*"]}, "belong to no component: bg.1"),
        ({"bar": ["bra.*"], "rest": ["*"]}, "'bra.*' of 'bar' matches no block"),
        ({"all": ["*"]}, "expected two or more"),
        ({"all": ["*"], "bar": ["bar.*"]}, "all blocks of 'bar' belong to components named before"),
        ({"one": ["bar.1", "bg.*", "ring.*"], "rest": ["*"]}, "neighbours with common faces"),
    ],
)
def test_components_that_do_not_fit_are_refused(components, message):
    with pytest.raises(CaseError, match=message.replace("*", r"\*")):
        set_up(GRID, Case(BAR + RING + FIXED, components=components))
