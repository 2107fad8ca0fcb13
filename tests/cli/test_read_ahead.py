"""Reading ahead changes nothing that a user sees: files, order of messages, limits."""

import pytest
from grids import CASE, frame

from meshdeform_cli.options import GridInput
from meshdeform_cli.read_ahead import ReadAhead
from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid
from meshdeform_core.grid.joints import find_joints
from meshdeform_core.memory import UNLIMITED, MemoryLimit
from meshdeform_core.parallel import set_threads
from meshdeform_formats import write_grid


@pytest.fixture(params=[1, 2])
def threads(request):
    set_threads(request.param)
    yield request.param
    set_threads(None)


@pytest.fixture
def source(tmp_path):
    write_grid(frame(), tmp_path / "grid.xyz")
    return GridInput(tmp_path / "grid.xyz", None, ())


@pytest.mark.parametrize("tolerance", [1e-3, 0.1])
def test_joints_are_those_of_the_grid_and_the_tolerance_of_the_case(source, threads, tolerance):
    with ReadAhead(source, UNLIMITED) as ahead:
        grid = ahead.grid(None, tolerance)
        found = ahead.joints(grid, tolerance)
    plain = find_joints(source.read(), tolerance)
    assert (grid.points == source.read().points).all()
    assert found.tolerance == tolerance
    assert found.openings == plain.openings
    for name in ("face_nodes", "number", "first", "edge", "partner", "handedness"):
        assert (getattr(found.topology, name) == getattr(plain.topology, name)).all()


def test_a_tolerance_that_comes_too_late_is_still_the_one_used(source):
    set_threads(2)
    try:
        with ReadAhead(source, UNLIMITED) as ahead:
            ahead._joints.result()
            grid = ahead.grid(None, 0.1)
            assert ahead.joints(grid, 0.1).tolerance == 0.1
    finally:
        set_threads(None)


def test_errors_of_the_grid_are_raised_when_it_is_asked_for(tmp_path, threads):
    (tmp_path / "grid.xyz").write_text("no grid")
    with ReadAhead(GridInput(tmp_path / "grid.xyz", None, ()), UNLIMITED) as ahead, pytest.raises(FormatError):
        ahead.grid(None, 1e-3)


def test_a_flat_grid_or_one_too_large_is_refused_by_the_run_not_beside_it(tmp_path, source, threads):
    blocks = frame()
    flat = Grid(blocks.points * [1.0, 1.0, 0.0], blocks.shapes, blocks.names)
    write_grid(flat, tmp_path / "flat.xyz")
    with ReadAhead(GridInput(tmp_path / "flat.xyz", None, ()), UNLIMITED) as ahead:
        assert ahead.grid(None, 1e-3).n_nodes == flat.n_nodes
    with ReadAhead(source, MemoryLimit(1000, "--max-memory allows")) as ahead:
        assert ahead.grid(None, 1e-3).n_nodes == blocks.n_nodes


def test_the_case_is_still_judged_before_the_grid(tmp_path, call):
    (tmp_path / "grid.xyz").write_text("no grid")
    (tmp_path / "case.toml").write_text("nonsense = 1")
    for threads in ("1", "2"):
        job = ("deform", tmp_path / "grid.xyz", "-c", tmp_path / "case.toml", "-o", tmp_path / "new.xyz")
        done = call(*job, "--threads", threads)
        assert done.code == 2
        assert "nonsense" in done.err
        assert "grid.xyz" not in done.err


def test_one_thread_and_two_write_the_same_file_and_the_same_warnings(tmp_path, source, call):
    (tmp_path / "case.toml").write_text(CASE)
    outcomes = []
    for threads in ("1", "2"):
        new = tmp_path / f"new{threads}.xyz"
        done = call("deform", source.path, "-c", tmp_path / "case.toml", "-o", new, "--threads", threads, "-q")
        outcomes.append((done.code, done.err, new.read_bytes()))
    assert outcomes[0] == outcomes[1]
