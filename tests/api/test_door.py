"""The public API: what a coupled solver writes, and what it gets when it writes something else."""

import copy
import dataclasses
import os
import pickle
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from grids import CASE, frame, with_walls
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import meshdeform as md
from meshdeform.grid import wrapped
from meshdeform_cli.main import run
from meshdeform_core.grid import Field
from meshdeform_core.parallel import thread_count
from meshdeform_core.parallel.loops import usable_cores

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def plate() -> md.Sample:
    return md.Sample(wrapped(with_walls(frame())), tomllib.loads(CASE))


@pytest.fixture(scope="module")
def mesh(plate: md.Sample) -> md.Mesh:
    return md.prepare(plate.grid, moving=["body"], fixed="outer", slip=["span"])


@pytest.fixture(scope="module")
def bend(mesh: md.Mesh) -> np.ndarray:
    displacement = np.zeros_like(mesh.points)
    displacement[:, 1] = 0.2 * mesh.points[:, 0] ** 2
    return displacement


def square(n: int = 7) -> md.Grid:
    line = np.linspace(0.0, 1.0, n)
    return md.Grid([np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1)])


def test_importing_loads_nothing_heavy_and_every_public_name_is_there():
    code = "import sys, meshdeform; print(sorted({'numpy', 'numba', 'click', 'h5py'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "[]"
    for name in md.__all__:
        assert getattr(md, name) is not None
    assert set(md.__all__) <= set(dir(md))
    with pytest.raises(AttributeError, match="prepar"):
        md.prepar  # noqa: B018


def test_the_library_gives_what_the_command_gives(plate, tmp_path):
    md.write(plate.grid, tmp_path / "grid.cgns")
    case = tmp_path / "case.toml"
    case.write_text(CASE)
    assert run(["deform", str(tmp_path / "grid.cgns"), "-c", str(case), "-o", str(tmp_path / "out.cgns"), "-q"]) == 0
    by_command = md.read(tmp_path / "out.cgns")
    by_mapping, by_file = md.deform(plate.grid, plate.case), md.deform(tmp_path / "grid.cgns", case)
    assert by_mapping.grid == by_command == by_file.grid
    measured = md.quality(by_command, reference=tmp_path / "grid.cgns", case=case)
    assert measured["shape"]["before"] == md.quality(plate.grid)["shape"]["after"] != measured["shape"]["after"]
    assert by_file.report["quality"] == measured["quality"]
    # Boundaries in a file of their own, named by an argument or by a case.
    assert run(["convert", str(tmp_path / "grid.cgns"), str(tmp_path / "new.xyz"), "-q"]) == 0
    apart, boundaries = tmp_path / "new.xyz", str(tmp_path / "new.nmf")
    assert {"body", "outer", "span"} < set(md.read(apart, boundary_file=boundaries).patches)
    body = {"select": "body", "motion": [{"translate": [0, 0, 0]}]}
    assert len(md.prepare(apart, {"grid": {"boundary_file": boundaries}, "boundary": [body]}).points) == 80
    with pytest.raises(md.FormatError, match="big"):
        md.read(apart, byte_order="big")


def test_array_patches_and_function_say_the_same(mesh, bend):
    steps = [mesh.deform(bend), mesh.deform({"body": bend}), mesh.deform(lambda x, t: t * 0.02 * bend, time=50.0)]
    assert steps[0].grid == steps[1].grid
    np.testing.assert_allclose(steps[2].grid.blocks[3], steps[0].grid.blocks[3], atol=1e-14)
    assert steps[0].valid
    assert steps[0].invalid_cells == ()


def test_the_wall_lands_exactly_where_it_was_told(mesh, bend):
    after = mesh.deform(bend).grid.blocks
    for b, before in enumerate(mesh.grid.blocks):
        rows = mesh.rows(b)
        moved = rows >= 0
        np.testing.assert_array_equal(before[moved], mesh.points[rows[moved]])
        np.testing.assert_array_equal(after[b][moved], before[moved] + bend[rows[moved]])
    place = mesh.nodes
    first = np.array([mesh.grid.blocks[b][i, j, k] for b, i, j, k in place])
    np.testing.assert_array_equal(first, mesh.points)
    assert mesh.mask("body").all()
    assert len(mesh.patches["body"]) == len(mesh.points)


def test_patches_that_share_nodes_must_agree():
    mesh = md.prepare(square(), moving={"low": "block1.jmin", "ends": ["block1.imin", "block1.imax"]}, method="tfi")
    low, ends = (np.zeros((len(rows), 3)) for rows in mesh.patches.values())
    assert (len(low), len(ends)) == (7, 14)
    low[:, 1] = 0.1 * (1.0 + mesh.points[mesh.patches["low"], 0])
    with pytest.raises(md.MotionError) as told:
        mesh.deform({"low": low, "ends": ends})
    where = "shared node (1, 0, 0) the displacement (0, 0, 0), another patch (0, 0.2, 0); expected the same"
    assert str(told.value) == f"patch 'ends' gives its {where}"
    ends[:, 1] = 0.1 * (1.0 + mesh.points[mesh.patches["ends"], 0])
    assert mesh.deform({"low": low, "ends": ends}).valid


def test_plane_grids_take_and_give_two_coordinates():
    mesh = md.prepare(square(), moving="block1.jmin", method="tfi")
    displacement = np.zeros((len(mesh.points), 2))
    displacement[:, 1] = 0.1
    step = mesh.deform(displacement)
    assert step.grid.blocks[0].shape == (7, 7, 2)
    np.testing.assert_allclose(step.grid.blocks[0][:, 0, 1], 0.1)


def test_free_faces_follow_the_wall():
    """Opposite to a wall that is translated, a free side moves too; by default it stays."""
    ends = []
    for free in (None, ["block1.jmax", "block1.imin", "block1.imax"]):
        mesh = md.prepare(square(), moving="block1.jmin", free=free, method="idw")
        displacement = np.zeros_like(mesh.points)
        displacement[:, 1] = 0.1
        ends.append(mesh.deform(displacement).grid.blocks[0][:, -1, 1])
    np.testing.assert_array_equal(ends[0], 1.0)
    np.testing.assert_allclose(ends[1], 1.1, atol=1e-12)


def overlapping() -> md.Grid:
    """A square behind a smaller one in its middle."""
    return md.Grid([4.0 * square().blocks[0] - 2.0, square().blocks[0]], ["back.1", "front.1"])


@pytest.mark.parametrize("components", ["zone prefix", {"front": "front.*", "back": ["*"]}])
def test_components_move_each_by_its_own_boundary(components):
    grid = overlapping()
    mesh = md.prepare(grid, moving="front.1.jmin", free="front.1.jmax", components=components, method="idw")
    displacement = np.zeros_like(mesh.points)
    displacement[:, 1] = 0.1
    step = mesh.deform(displacement)
    alone = md.prepare(md.Grid([grid.blocks[1]]), moving="block1.jmin", free="block1.jmax", method="idw")
    np.testing.assert_array_equal(step.grid.blocks[0], grid.blocks[0])
    np.testing.assert_array_equal(step.grid.blocks[1], alone.deform(displacement).grid.blocks[0])
    assert [(part["name"], part["moving_nodes"]) for part in step.report["components"]] == [("back", 0), ("front", 7)]
    linear = mesh.linearise(displacement)
    assert not np.any(linear.jvp(displacement)[0])


def test_components_are_part_of_a_case_or_an_argument():
    with pytest.raises(md.MeshDeformError, match="found a case and components"):
        md.prepare(overlapping(), {"boundary": []}, components="zone prefix")
    with pytest.raises(md.MeshDeformError, match=r"grid\.components = 'zones'"):
        md.prepare(overlapping(), moving="front.1.jmin", components="zones")


def test_periodic_images_follow():
    mesh = md.prepare(square(), moving={"low": "block1.jmin"}, periodic=["block1.imin", "block1.imax"], method="idw")
    displacement = np.zeros_like(mesh.points)
    displacement[:, 1] = 0.1
    after = mesh.deform(displacement).grid.blocks[0]
    np.testing.assert_allclose(after[0, :, 1], after[-1, :, 1], atol=1e-14)


@pytest.mark.parametrize(
    ("method", "name"),
    [
        (md.TFI(), "tfi"),
        (md.IDW(alpha=0.2), "idw"),
        (md.RBF(), "rbf"),
        (md.Hybrid(md.RBF(), md.TFI(max_cells=8)), "rbf-tfi"),
        ("idw-rbf", "idw-rbf"),
    ],
)
def test_methods_are_objects_or_names(plate, method, name):
    mesh = md.prepare(plate.grid, plate.case, method=method)
    assert mesh.method == name
    assert mesh.deform(time=0.0).report["method"]["name"] == name


def test_a_case_may_be_made_of_python_objects():
    motion = [{"translate": np.array([0, 0.1, 0])}, {"translate": [0, 0, "0*t"]}, {"displace": [0, "0.1*t", 0]}]
    case = {
        "boundary": [{"name": "low", "select": "block1.jmin", "motion": motion}],
        "method": md.Hybrid(md.IDW(), md.TFI()),
    }
    step = md.deform(square(), case, time=0.5, steps=2, repair="off")
    assert (step.valid, step.steps, step.report["method"]["name"]) == (True, 2, "idw-tfi")
    assert step.report["timing"]["total"] == pytest.approx(sum(step.result.timing.seconds.values()))
    np.testing.assert_allclose(step.grid.blocks[0][:, 0, 1], 0.15)
    assert md.deform(square(), case, method="tfi").report["method"]["name"] == "tfi"


WRONG_DISPLACEMENTS = {
    "complex": lambda d: d.astype(complex),
    "masked": lambda d: np.ma.masked_where(d > 0, d),
    "ragged": lambda d: [[0.0, 1.0, 2.0], [0.0]],
    "nothing": lambda d: None,
    "patch": lambda d: {"bodi": d},
    "function": lambda d: lambda x, t: d[:3],
    "bool": lambda d: d > 0,
    "beyond all lengths": lambda d: d + 1e31,
}


@pytest.mark.parametrize("wrong", WRONG_DISPLACEMENTS.values(), ids=WRONG_DISPLACEMENTS.keys())
def test_a_wrong_displacement_is_told(mesh, bend, wrong):
    with pytest.raises(md.MotionError, match=r"expected .*(\(80, 3\)|finite|lengths|'body'|deform\(displacement\))"):
        mesh.deform(wrong(bend))


def endless() -> dict:
    case: dict = {}
    case["boundary"] = [case]
    return case


WRONG_CALLS = {
    "nothing moves": (lambda g: md.prepare(g), "nothing moves"),
    "unknown patch": (lambda g: md.prepare(g, moving=["bdy"]), "did you mean 'body'"),
    "a method that is a number": (lambda g: md.prepare(g, moving="body", method=3), "expected a name"),
    "rows of all": (
        lambda g: md.prepare(g, moving="body").deform(np.zeros((3, 3))),
        r"one row per node of mesh\.points",
    ),
    "rows of a patch": (
        lambda g: md.prepare(g, moving=["body", "outer"]).deform(dict.fromkeys(("body", "outer"), np.zeros((3, 3)))),
        "one row per node of the patch",
    ),
    "a hybrid of two": (lambda g: md.Hybrid(md.IDW(alpha=0.2), md.IDW()), "expected the same options"),
    "a patch twice": (lambda g: md.prepare(g, moving=["body", "body"]), "moving = .* names a patch twice"),
    "a time that is true": (lambda g: md.prepare(g, moving="body").deform(0.0, time=True), "time = True"),
    "threads that are true": (lambda g: md.prepare(g, moving="body", threads=True), "threads = True"),
    "a size that is true": (lambda g: md.sample("beam", True), "size = True"),
    "a block before the first": (lambda g: md.prepare(g, moving="body").rows(-1), "block -1; expected 0 to 7"),
    "a hybrid not offered": (lambda g: md.Hybrid(md.TFI(), md.IDW()), "known are"),
    "case and selection": (lambda g: md.prepare(g, {"boundary": []}, moving="body"), "only one of them"),
    "a case that is a list": (lambda g: md.prepare(g, [1]), "case is a list"),
    "a list of arrays": (lambda g: md.prepare([np.zeros((3, 3, 3, 3))], moving="x"), r"wrap .* in Grid"),
    "a name that is a number": (lambda g: md.read(3), "file name 3"),
    "one array for blocks": (lambda g: md.Grid(np.zeros((3, 3, 3, 3))), "expected a sequence"),
    "a block with three indices": (lambda g: md.Grid([np.zeros((3, 4, 5))]), r"\(3, 4, 5\)"),
    "blocks by name": (lambda g: md.Grid({"a": g.blocks[0]}), "blocks is a dict"),
    "names that are a text": (lambda g: md.Grid(g.blocks[:3], "abc"), "names = 'abc'"),
    "a file name with a null": (lambda g: md.write(g, "a\0b.cgns"), "null character"),
    "a selection of nothing": (lambda g: md.prepare(g, moving={"body": None}), "expected patch names"),
    "a case inside itself": (lambda g: md.prepare(g, endless()), "nested more than"),
    "steps that are true": (lambda g: md.prepare(g, moving="body").deform(0.0, steps=True), "steps = True"),
    "a time that is nan": (lambda g: md.prepare(g, moving="body").deform(0.0, time=float("nan")), "time = nan"),
    "a block with nan": (lambda g: md.Grid([np.full((3, 3, 3, 3), np.nan)]), "not finite"),
    "mixed blocks": (lambda g: md.Grid([np.zeros((3, 3, 2)), np.zeros((3, 3, 3, 3))]), "mixed"),
    "threads": (lambda g: md.prepare(g, moving="body", threads=0), "threads = 0"),
    "memory": (lambda g: md.prepare(g, moving="body", max_memory="2 cats"), "2 cats"),
    "too little memory": (lambda g: md.prepare(g, moving="body", max_memory=1000), "needs about"),
    "moving and fixed": (lambda g: md.prepare(g, moving="body", fixed="body"), "selected twice"),
    "other blocks": (lambda g: md.compare(g, square()), "expected the same blocks"),
    "a function of points alone": (
        lambda g: md.prepare(g, moving="body").deform(lambda points: points),
        r"function\(points\); expected one of \(points, time\)",
    ),
}


@pytest.mark.parametrize(("call", "message"), WRONG_CALLS.values(), ids=WRONG_CALLS.keys())
def test_a_wrong_call_is_told(plate, call, message):
    with pytest.raises(md.MeshDeformError, match=message):
        call(plate.grid)


NUMBERS = hnp.arrays(
    dtype=st.one_of(
        hnp.floating_dtypes(),
        hnp.integer_dtypes(),
        hnp.complex_number_dtypes(),
        hnp.boolean_dtypes(),
        hnp.unicode_string_dtypes(),
    ),
    shape=hnp.array_shapes(min_dims=0, max_dims=4, max_side=8),
)


@settings(max_examples=25)
@given(NUMBERS)
def test_any_array_gives_a_finite_grid_or_a_message(values):
    """Whatever its shape, type and values: displacement and block coordinates are taken as they are, or refused."""
    mesh = md.prepare(square(4), moving="block1.jmin", method="tfi")
    try:
        step = mesh.deform(values)
    except md.MotionError:
        return
    assert values.shape in ((4, 3), (4, 2))
    assert np.isfinite(values).all()
    assert np.isfinite(step.grid.blocks[0]).all()


@settings(max_examples=60)
@given(NUMBERS)
def test_any_block_is_a_grid_or_a_message(values):
    try:
        grid = md.Grid([values])
    except md.GridError:
        return
    assert values.ndim in (3, 4)
    np.testing.assert_array_equal(grid.blocks[0], values.astype(np.float64))


class Tagged(np.ndarray):
    """An array of another package."""


def tagged(array, **attributes):
    """The array with attributes, among them its unit."""
    found = array.view(Tagged)
    vars(found).update(attributes)
    return found


def test_units_are_not_dropped(plate, mesh, bend):
    """An array of millimetres is not taken for one in the unit of the grid; without a dimension the unit is empty."""
    with pytest.raises(md.MotionError, match="has the unit 'mm'; expected plain numbers"):
        mesh.deform(tagged(bend, units="mm"))
    with pytest.raises(md.MotionError, match="has the unit 'mm'"):
        mesh.deform({"body": tagged(bend, unit="mm")})
    with pytest.raises(md.GridError, match="block 'block1' has the unit 'mm'"):
        md.Grid([tagged(plate.grid.blocks[0], units="mm")])
    assert mesh.deform(tagged(bend, unit="")).grid == mesh.deform(bend).grid


def test_numbers_of_numpy_are_numbers(plate, bend):
    mesh = md.prepare(plate.grid, moving="body", slip="span", threads=np.int64(1), max_memory=np.uint64(4 * 10**9))
    assert mesh.deform(bend, steps=np.int32(2), time=np.float32(0.5), repair="off").steps == 2


def test_threads_take_turns(plate):
    """What earlier displacements leave behind in a mesh is not mixed up by calls at the same time."""
    mesh, other = (md.prepare(plate.grid, plate.case, method="rbf-tfi", threads=n) for n in (1, 2))
    shapes = [np.sin(mesh.points * k) * 0.02 * [1.0, 1.0, 0.0] for k in range(1, 5)]
    expected = [mesh.deform(each, repair="off").grid.blocks for each in shapes]
    for _ in range(3):
        with ThreadPoolExecutor(6) as pool:
            meshes = [mesh, mesh, other, mesh]
            found = list(pool.map(lambda m, x: m.deform(x, repair="off").grid.blocks, meshes, shapes))
        for known, blocks in zip(expected, found, strict=True):
            assert max(np.abs(a - b).max() for a, b in zip(known, blocks, strict=True)) < 1e-12
    assert thread_count() == usable_cores()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no processes are forked here")
def test_a_forked_process_does_not_wait_for_threads_that_it_lacks(mesh, bend):
    code = """
import os, threading, time, numpy as np, meshdeform as md
from meshdeform.mesh import one_at_a_time
held = threading.Event()
def hold():
    with one_at_a_time():
        held.set()
        time.sleep(60)
threading.Thread(target=hold, daemon=True).start()
held.wait()
child = os.fork()
if child == 0:
    line = np.linspace(0, 1, 4)
    grid = md.Grid([np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1)])
    step = md.prepare(grid, moving="block1.jmin", method="tfi").deform(np.tile([0.0, 0.05, 0.0], (4, 1)))
    os._exit(0 if step.valid else 1)
os._exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    assert subprocess.run([sys.executable, "-c", code], timeout=50).returncode == 0


def test_what_is_given_is_not_touched_or_kept(mesh, bend):
    given, before = bend.copy(), mesh.points.copy()
    step = mesh.deform(given)
    np.testing.assert_array_equal(given, bend)
    given[:] = 1e9
    assert mesh.deform(bend).grid == step.grid
    block = np.random.default_rng(1).random((3, 3, 3, 3))
    grid = md.Grid([block])
    block[:] = 0.0
    assert grid.blocks[0].any()
    for array in (mesh.points, step.grid.blocks[0], grid.blocks[0]):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0
    np.testing.assert_array_equal(mesh.points, before)


def test_objects_are_pleasant_at_a_prompt(plate, mesh, bend):
    step = mesh.deform(bend)
    for thing in (plate.grid, mesh, step, step.result, step.result.setup):
        assert len(repr(thing)) < 200
        assert "array" not in repr(thing)
    assert repr(plate.grid) == "Grid(8 blocks, 1,152 nodes, 600 cells, 3-D)"
    assert repr(step).startswith("Step(valid; 1 step, ")
    assert plate.grid != md.Grid([np.array(block) for block in plate.grid.blocks], list("abcdefgh"))
    assert square() != md.Grid([np.pad(square().blocks[0], ((0, 0), (0, 0), (0, 1)))[:, :, None]])
    with pytest.raises(TypeError, match="unhashable"):
        hash(plate.grid)


def test_objects_can_be_copied_and_pickled(mesh, bend):
    step = mesh.deform(bend)
    for again in (pickle.loads(pickle.dumps(step)), copy.deepcopy(step), copy.copy(step)):
        assert again.grid == step.grid
        assert again.report["quality"] == step.report["quality"]
    assert pickle.loads(pickle.dumps(mesh)).deform(bend).grid == step.grid
    assert copy.deepcopy(mesh.grid) == mesh.grid
    assert pickle.loads(pickle.dumps(md.Hybrid(md.IDW(), md.TFI()))) == md.Hybrid(md.IDW(), md.TFI())


def test_grids_become_those_of_other_packages(plate):
    assert len(plate.grid.to_meshio().cells[0].data) == plate.grid.n_cells
    pyvista = pytest.importorskip("pyvista", reason="pyvista is not installed")
    blocks = plate.grid.to_pyvista("volume")
    assert isinstance(blocks, pyvista.MultiBlock)
    assert [blocks[n].n_cells for n in range(len(plate.grid))] == [
        int(np.prod([n - 1 for n in shape])) for shape in plate.grid.shapes
    ]
    for block in blocks:
        np.testing.assert_allclose(block.cell_data["volume"], block.compute_cell_sizes().cell_data["Volume"])
    nodes = plate.grid.blocks[0] @ [1.0, 10.0, 100.0]
    cells = (nodes[:-1, :-1, :-1] + nodes[1:, 1:, 1:]) / 2
    fields = Field("p", "node", 0, nodes), Field("q", "cell", 0, cells)
    block = wrapped(dataclasses.replace(plate.grid.core, fields=fields)).to_pyvista()[0]
    np.testing.assert_allclose(block.point_data["p"], block.points @ [1.0, 10.0, 100.0])
    np.testing.assert_allclose(block.cell_data["q"], block.cell_centers().points @ [1.0, 10.0, 100.0])


def test_grids_draw_themselves(plate, mesh, bend, tmp_path):
    after = mesh.deform(bend).grid
    figure = after.plot(
        "displacement", reference=plate.grid, plane="k=1", limits=(0, 0.5), title="bent", zoom=(-0.7, 0.7, -0.6, 0.6)
    )
    assert figure.axes[0].get_xlim() == (-0.7, 0.7)
    assert [text.get_text() for text in figure.texts] == ["bent"]
    md.write(plate.grid, tmp_path / "grid.cgns")
    figures = [md.read(tmp_path / "grid.cgns").plot(title=title) for title in (None, "")]
    assert [[text.get_text() for text in each.texts] for each in figures] == [["grid.cgns"], []]
    figure.savefig(tmp_path / "bent.png")
    assert (tmp_path / "bent.png").stat().st_size > 10_000
    with pytest.raises(md.CaseError, match="measure 'skew' is unknown; did you mean 'f_skew'"):
        plate.grid.plot("skew")


def test_files_are_not_overwritten_unasked(plate, tmp_path):
    path = tmp_path / "grid.xyz"
    md.write(plate.grid, path, encoding="ascii")
    with pytest.raises(md.FormatError, match="exists"):
        md.write(plate.grid, path)
    md.write(plate.grid, path, force=True)
    os.link(path, tmp_path / "same.xyz")
    with pytest.raises(md.FormatError, match="read from"):
        md.write(md.read(path), tmp_path / "same.xyz", force=True)
    assert md.compare(plate.grid, path).largest == 0.0


def test_the_example_runs(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "examples")
    import coupling

    steps = coupling.main(tmp_path)
    assert all(step.valid for step in steps)
    assert md.read(tmp_path / "bent.cgns") == steps[-1].grid


def test_repairs_are_made_unless_they_are_declined():
    bars = md.sample("cascade", 4)
    mesh = md.prepare(bars.grid, {**bars.case, "constants": {"angle": 110.0}}, method="tfi")
    broken = mesh.deform(steps=1, repair="off")
    assert not broken.valid
    assert broken.repair is None
    assert broken.invalid_cells
    mended = mesh.deform()
    assert mended.valid
    assert mended.repair is not None
    for b in range(len(bars.grid)):
        moved = mesh.rows(b) >= 0
        np.testing.assert_array_equal(mended.grid.blocks[b][moved], broken.grid.blocks[b][moved])
    with pytest.raises(md.CaseError, match="known are auto"):
        mesh.deform(repair="always")  # type: ignore[arg-type]
