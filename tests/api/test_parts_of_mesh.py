"""``prepare(..., comm=comm)``: every rank holds its part of the grid and of the results."""

import itertools
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from forked_ranks import on_ranks, poison_parts, small_blocks_are_cut
from grids import frame_2d, tapered

import meshdeform as md
from meshdeform import tasks
from meshdeform_core.parallel import ONE_PROCESS
from meshdeform_core.velocity import swept_volumes

MEASURES = "f_skew", "f_skew_min", "scaled_jacobian_min", "volume"


@pytest.fixture
def source(tmp_path, monkeypatch):
    """A grid file; ``comm`` is the ranks themselves, and blocks are cut although they are small."""
    monkeypatch.setattr(tasks, "ranks_of_comm", lambda comm: comm or ONE_PROCESS)
    grid = tapered(5, 4)
    path = tmp_path / "grid.xyz"
    md.write(md.Grid([grid.block(b) for b in range(grid.n_blocks)]), path)
    with small_blocks_are_cut(monkeypatch):
        yield path


def prepared(path, ranks=ONE_PROCESS, **rest):
    bar = ["block2.imax", "block4.jmax", "block5.jmin", "block7.imin"]
    return md.prepare(path, moving=bar, slip=["*.kmin", "*.kmax"], comm=ranks, **rest)


def turned(points, time):
    """The bar turned far enough for weak cells."""
    c, s = np.cos(0.9), np.sin(0.9)
    return points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) - points


def small(points, time):
    """A motion that needs no repair."""
    return 0.1 * turned(points, time)


def lasting(report):
    """What does not depend on the machine; the time of the repair is in the report, too."""
    return {key: value for key, value in report.items() if key not in ("timing", "peak_memory_bytes", "repair")}


def test_every_rank_has_its_part_of_the_grid_and_of_the_result(source, tmp_path):
    one = prepared(source)
    step = one.deform(turned)
    expected, start, report = step.grid.blocks, one.grid.blocks, step.report
    assert step.repair is not None
    assert len(one.grid.part) == len(expected)

    def act(ranks):
        mesh = prepared(source, ranks)
        np.testing.assert_array_equal(mesh.points, one.points)
        found = mesh.deform(turned)
        for part, before in zip(found.grid.part, mesh.grid.part, strict=True):
            np.testing.assert_array_equal(part.points, expected[part.block][part.first : part.last])
            np.testing.assert_array_equal(before.points, start[part.block][part.first : part.last])
        for act in (
            lambda: found.grid.blocks, lambda: found.swept_volumes(one.grid),
            lambda: md.compare(found.grid, mesh.grid), lambda: md.quality(found.grid),
            lambda: step.swept_volumes(mesh.grid),
            lambda: one.grid.plot(reference=mesh.grid), lambda: md.prepare(found.grid, moving=["block2.imax"]),
            found.grid.plot,
        ):  # fmt: skip
            with pytest.raises(md.GridError, match=r"takes the whole grid on every rank.*Grid\.gathered"):
                act()
        with ThreadPoolExecutor(1) as other, pytest.raises(md.GridError, match="in another thread"):
            other.submit(mesh.deform, turned).result()
        assert lasting(found.report) == lasting(report)
        md.write(found.grid, tmp_path / "out.xyz")
        assert all(map(np.array_equal, found.grid.gathered().blocks, expected))
        return [(part.block, part.first, part.last) for part in found.grid.part]

    found = [rows for each in on_ranks(3, act) for rows in each]
    nodes = [(block, i) for block, first, last in found for i in range(first, last)]
    assert nodes == [(b, i) for b, block in enumerate(expected) for i in range(len(block))]
    assert all(map(np.array_equal, md.read(tmp_path / "out.xyz").blocks, expected))


def test_what_takes_the_whole_grid_is_refused_on_all_ranks_and_other_derivatives_are_those_of_the_method(source):
    def act(ranks):
        with pytest.raises(md.GridError, match="inside blocks: that takes the whole grid"):
            prepared(source, ranks, method="idw-rbf").linearise()
        mesh = prepared(source, ranks)
        at = mesh.linearise(repair="off")
        # An error on one rank alone is raised on all.
        wrong = [np.full(part.points.shape, np.nan if ranks.number else 0.0) for part in at.step.grid.part]
        with pytest.raises(md.GridError, match="not finite"):
            at.vjp(wrong)
        repaired, stepped = mesh.linearise(turned), mesh.linearise(turned, steps=2, repair="off")
        assert not repaired.exact
        assert not stepped.exact
        return repaired.reason, stepped.reason

    for repaired, stepped in on_ranks(2, act):
        assert "in parts, and the derivative of that takes the whole grid" in repaired
        assert "imposed in 2 steps" in stepped


def test_a_grid_that_every_rank_holds_as_a_whole_is_divided(source, tmp_path):
    """A grid object, and a file that can only be read as a whole."""
    text = tmp_path / "text.xyz"
    md.write(md.read(source), text, encoding="ascii")

    def act(ranks):
        own, *others = (prepared(grid, ranks) for grid in (source, md.read(source), text))
        moved = own.deform(small).grid.part
        for mesh in others:
            assert [part[:3] for part in mesh.grid.part] == [part[:3] for part in own.grid.part]
            for one, two in zip(mesh.deform(small).grid.part, moved, strict=True):
                np.testing.assert_allclose(one.points, two.points, atol=1e-9)
        return own.grid.part[0].first, own.grid.part[-1].block

    first, second = on_ranks(2, act)
    assert first != second


METHODS = {
    "tfi": "tfi", "idw": md.IDW(), "rbf": md.RBF(),
    "idw-tfi, fast": md.Hybrid(md.IDW(summation="fast", alpha=0.3), md.TFI(max_cells=4)),
    "rbf-tfi": md.Hybrid(md.RBF(), md.TFI(max_cells=3)),
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in ("idw", "rbf-tfi") else ()) for name in METHODS]
)
def test_derivatives_in_parts(source, name, monkeypatch):
    rng = np.random.default_rng(4)
    whole = prepared(source, method=METHODS[name]).linearise(small, repair="off")
    change = rng.standard_normal((len(whole._mesh.numbers), 3))
    gradient = [rng.standard_normal(block.shape) for block in whole.step.grid.blocks]
    pushed, pulled, reason = whole.jvp(change), whole.vjp(gradient), whole.reason
    poison_parts(monkeypatch)

    def act(ranks):
        own = prepared(source, ranks, method=METHODS[name]).linearise(small, repair="off")
        assert own.reason == reason
        pieces = own.jvp(change)
        for part, found in zip(own.step.grid.part, pieces, strict=True):
            np.testing.assert_array_equal(found, pushed[part.block][part.first : part.last])
        np.testing.assert_array_equal(own.operator @ change.ravel(), np.concatenate([p.ravel() for p in pieces]))
        given = [gradient[part.block][part.first : part.last] for part in own.step.grid.part]
        found = own.vjp(given)
        np.testing.assert_array_equal(own.operator.T @ np.concatenate([p.ravel() for p in given]), found.ravel())
        # Solving an RBF system magnifies round-off.
        error = 1e-11 if "rbf" in name else 1e-13
        np.testing.assert_allclose(found, pulled, rtol=0.0, atol=error * np.abs(pulled).max())
        return found

    one, *others = on_ranks(2 if name == "rbf" else 3, act)
    assert all(np.array_equal(one, other) for other in others)


@pytest.mark.parametrize("plane", [False, True], ids=["3-D", "2-D"])
def test_swept_volumes_and_gradients_of_quality_in_parts(source, plane, tmp_path, monkeypatch):
    if plane:
        grid = frame_2d(7)
        md.write(md.Grid([grid.block(b) for b in range(grid.n_blocks)]), tmp_path / "plane.xyz")
    path = tmp_path / "plane.xyz" if plane else source
    sides = [] if plane else ["*.kmin", "*.kmax"]

    def moved(ranks=ONE_PROCESS):
        body = {"select": ["*.i*", "*.j*"], "where": "abs(x) < 0.51 and abs(y) < 0.51", "kind": "moving"}
        body["motion"] = [{"displace": ["0.2*y", "0.2*x", "0"]}]
        slip = [{"name": "sides", "select": sides, "kind": "slip"}] if sides else []
        case = {"boundary": [{"name": "body", **body}, *slip]}
        mesh = md.prepare(path, case, comm=ranks)
        return mesh, mesh.deform()

    mesh, step = moved()
    asked = [*itertools.product(MEASURES, [None]), ("volume", [2, 0]), ("f_skew_min", [1])]
    expected = [step.quality_gradient(name, 50.0, blocks) for name, blocks in asked]
    swept = step.swept_volumes(mesh.grid)
    whole, start = step.result.setup.grid, mesh.grid.core.points
    for faces, shape, every in zip(
        swept, whole.shapes, swept_volumes(whole, start, step.grid.core.points), strict=True
    ):
        every = [each for each, n in zip(every, shape, strict=True) if n > 1]
        assert all(map(np.array_equal, faces, [each[:, :, 0] for each in every] if plane else every))
    assert all(np.abs(each).max() < 1e-12 for faces in step.swept_volumes(step) for each in faces)
    for wrong in (3, md.Grid([block[:-1] for block in mesh.grid.blocks])):
        with pytest.raises(md.GridError):
            step.swept_volumes(wrong)
    poison_parts(monkeypatch)

    def act(ranks):
        own, found = moved(ranks)
        for part, faces in zip(found.grid.part, found.swept_volumes(own.grid), strict=True):
            for axis, (each, every) in enumerate(zip(faces, swept[part.block], strict=True)):
                np.testing.assert_array_equal(each, every[part.first : part.last])
                assert len(each) == min(part.last, len(every)) - part.first, axis
        for (name, blocks), every in zip(asked, expected, strict=True):
            value, gradient = found.quality_gradient(name, 50.0, blocks)
            assert value == every.value
            for part, each in zip(found.grid.part, gradient, strict=True):
                np.testing.assert_array_equal(each, every.blocks[part.block][part.first : part.last])
        with pytest.raises(md.GridError, match="expected numbers from 0"):
            found.quality_gradient("volume", blocks=[99])
        return sum(len(part.points) for part in found.grid.part)

    assert sum(on_ranks(2 if plane else 3, act)) == sum(map(len, step.grid.blocks))
