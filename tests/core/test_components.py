"""Components of overset grids: each is deformed exactly as if it were alone."""

import dataclasses
import re
from types import SimpleNamespace

import numpy as np
import pytest
from cases import STILL, constant, told, turning
from grids import block_around, frame, interleaved, polar

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.deform import Case, deform, set_up
from meshdeform_core.errors import CaseError
from meshdeform_core.grid import Grid
from meshdeform_core.grid.openings import find_openings
from meshdeform_core.grid.selection import BY_PREFIX, with_components
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.methods import RBF, Options
from meshdeform_core.repair import RepairOptions
from meshdeform_core.series import Schedule, deform_series
from meshdeform_core.wording import kind_of

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


GREEDY = RBF(basis="ctps-c1", radius=6.0, greedy="hybrid", greedy_tolerance=1e-30)


@pytest.mark.parametrize("method", [Options(), Options("rbf", rbf=GREEDY), Options("tfi")], ids=lambda each: each.name)
def test_every_component_moves_as_if_it_were_alone(method):
    whole = deform(GRID, case(BAR + RING + FIXED, method, BY_PREFIX))
    settings, notices, motions = {}, {}, ()
    for own, specs in (("bar", BAR), ("ring", RING)):
        single = deform(alone(GRID, own), case(specs, method))
        np.testing.assert_array_equal(part_of(whole.grid, own), single.grid.points)
        result = dict(whole.components)[own]
        assert (result.steps, result.valid) == (single.steps, single.valid)
        assert result.assessment.after == single.assessment.after
        settings[own], motions = single.account.settings, motions + single.motion
        said = single.account.notices.items()
        notices |= {f"{own}: {kind}": f"component {own!r}: {text}" for kind, text in said}
    np.testing.assert_array_equal(part_of(whole.grid, "bg"), part_of(GRID, "bg"))
    # A setting has the name of its component unless it is the same in both.
    bar, ring = settings.values()
    named = [(key if bar.get(key) == ring.get(key) else f"{key} of {own}", value)
             for own, each in settings.items() for key, value in each.items()]  # fmt: skip
    assert whole.account.settings == dict(named)
    assert (whole.account.notices, whole.motion) == (notices, motions)
    assert ["greedy reduction stopped with" in text for text in notices.values()] == [True] * 2 * (method.name == "rbf")


def test_as_much_of_the_motion_is_reached_as_the_component_that_fails_reaches():
    far = tuple(dataclasses.replace(spec, motion=turning(150.0)) if spec.name == "bar" else spec for spec in BAR)
    whole = deform(GRID, case(far + RING + FIXED, Options("tfi"), BY_PREFIX, mode="off"), steps="auto")
    own = dict(whole.components)
    assert own["bar"].reached < own["ring"].reached == 1.0
    assert (whole.reached, whole.steps, whole.valid) == (own["bar"].reached, own["bar"].steps, False)
    assert {cell.step for cell in own["bar"].assessment.invalid} == {whole.steps + 1}


def both_move(bar, ring) -> tuple[BoundarySpec, ...]:
    """The wall of the ring moves, too, within a fixed outer side."""
    bar, ring = (dataclasses.replace(spec, motion=own) for spec, own in ((BAR[0], bar), (RING[0], ring)))
    return bar, *BAR[1:], ring, dataclasses.replace(RING[1], kind=Kind.FIXED), RING[2], *FIXED


def test_what_is_said_of_components_is_joined():
    specs = both_move(turning(75.0), turning(120.0, center=(1.5, 0.7, 0.0)))
    whole = deform(GRID, case(specs, Options("tfi"), BY_PREFIX), steps=1)
    single = deform(alone(GRID, "bar"), case(specs[:3], Options("tfi")), steps=1)
    np.testing.assert_array_equal(part_of(whole.grid, "bar"), single.grid.points)
    names, (_, *results) = zip(*whole.components, strict=True)
    assert names == ("bg", "bar", "ring")
    assert (results[0].attempts, results[0].repair.nodes) == (single.attempts, single.repair.nodes)
    said = [(f"component {name!r}: {text}", f"{name}: {kind_of(text)}")
            for name, own in zip(names[1:], results, strict=True) for text in own.warnings]  # fmt: skip
    assert [(text, kind_of(text)) for text in whole.warnings] == said
    assert len(said) == 2
    assert whole.attempts == results[0].attempts + results[1].attempts
    assert len(whole.attempts) == 4
    one, two = (own.repair for own in results)
    assert one.invalid < two.invalid
    for name, total in (("invalid", sum), ("weak", sum), ("nodes", sum), ("newton_steps", sum), ("max_movement", max)):
        assert getattr(whole.repair, name) == total((getattr(one, name), getattr(two, name)))
    assert {"prepare", "apply", "quality", "repair"} <= set(whole.timing.seconds)


def test_what_a_method_prepared_on_all_components_gives_is_that_of_each():
    specs = both_move(turning(180.0), turning(180.0, center=(1.5, 0.7, 0.0)))
    whole = set_up(GRID, case(specs, components=BY_PREFIX)).undeformed
    method, at, random = whole.prepare(Options()), told(whole), np.random.default_rng(1)
    derivative, change = method.linearised(at), random.standard_normal(at.shape)
    weight = random.standard_normal(GRID.points.shape)
    applied, moved, gradient = method.apply(at), derivative.push(change), derivative.pull(weight.copy())
    warnings, kinks = whole.prepare(Options("tfi")).warnings_for(at, 0.5 * at), 0
    for name in ("bar", "ring"):
        (numbers,) = (each.numbers for each in whole.components if each.name == name)
        rows = np.isin(whole.source_numbers, numbers)
        single = set_up(alone(GRID, name), case([each for each in specs if each.name.startswith(name)])).undeformed
        prepared, own = single.prepare(Options()), single.prepare(Options()).linearised(at[rows])
        np.testing.assert_array_equal(part_of(GRID, name, applied), prepared.apply(at[rows]))
        np.testing.assert_array_equal(part_of(GRID, name, moved), own.push(change[rows]))
        np.testing.assert_array_equal(gradient[rows], own.pull(part_of(GRID, name, weight)))
        kinks, gradient[rows] = kinks + sum(own.kinks.values()), 0.0
        (text,) = single.prepare(Options("tfi")).warnings_for(at[rows], 0.5 * at[rows])
        assert warnings.pop(0) == f"component {name!r}: {text}"
    for rest in (part_of(GRID, "bg", moved), part_of(GRID, "bg", applied), gradient, warnings):
        assert not np.any(rest)
    assert sum(derivative.kinks.values()) == kinks > 0

    def one(result, method, displacement):
        return method.linearised(displacement), result

    results = SimpleNamespace(components=[("bg", "?"), ("bar", ""), ("ring", "why")])
    found, reason = method.differentiated(results, at, one)
    np.testing.assert_array_equal(found.push(change), moved)
    assert reason == "component 'ring': why"


def test_invalid_cells_are_listed_with_the_walls_of_their_own_component_and_the_worst_first():
    """The ring comes after the bar, and has the worst cell."""
    specs = both_move(turning(75.0), turning(150.0, center=(1.5, 0.7, 0.0)))
    result = deform(GRID, case(specs, components=BY_PREFIX, mode="off"))
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
    assert {name for crossing in contact.crossings for name in crossing.patches} <= {"bar", "bar far"}
    # The ring, which comes later, meets itself earlier.
    both = both_move(out.motion, constant(5.0, 0.0, 0.0))
    setup = set_up(GRID, case(both, components=BY_PREFIX))
    earlier = setup.undeformed.contact(setup.motion(0.0))
    assert earlier.fraction < contact.fraction
    assert {name for crossing in earlier.crossings for name in crossing.patches} <= {"ring", "ring far"}
    setup = set_up(GRID, case(both_move(constant(1.6, 0.0, 0.0), constant(2.0, 0.0, 0.0)), components=BY_PREFIX))
    found = [(each.patches, each.count) for each in setup.undeformed.crossings(setup.motion(0.0)(1.0))]
    assert found == [(("ring", "ring far"), 15), (("bar", "bar far"), 9)]


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
    line = np.linspace(0.0, 1.0, 4)
    near = Grid.from_blocks([block_around(at, line, line) for at in (line, line + 1.001)], ["a.1", "b.1"])
    assert [each.matching for each in find_openings(near, find_topology(near))] == [True]
    assert not find_openings(with_components(near, BY_PREFIX), find_topology(near))


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
        (
            {"one": ["bar.1", "bg.*", "ring.*"], "rest": ["*"]},
            "bar.1 of 'one' and bar.4 of 'rest' are neighbours with common faces (12 between",
        ),
    ],
)
def test_components_that_do_not_fit_are_refused(components, message):
    with pytest.raises(CaseError, match=re.escape(message)):
        set_up(GRID, Case(BAR + RING + FIXED, components=components))
