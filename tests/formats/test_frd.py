"""Results of CalculiX as text, by a writer of the test."""

import numpy as np
import pytest

from meshdeform_core.boundary.motions.histories import Modes
from meshdeform_core.errors import CaseError, FormatError
from meshdeform_formats.case import case_of
from meshdeform_formats.displacement import read_displacement
from meshdeform_formats.displacement.frd import read_shapes

HEXAHEDRON = 1


def box(ni: int, nj: int, nk: int):
    """Points, node numbers from 11 in steps of 3, and hexahedra of a block."""
    number = 11 + 3 * np.arange(ni * nj * nk).reshape(ni, nj, nk)
    points = np.indices((ni, nj, nk)).reshape(3, -1).T * [1.0, 2.0, 0.5]
    corner = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    cells = np.stack([number[a : ni - 1 + a, b : nj - 1 + b, c : nk - 1 + c].ravel() for a, b, c in corner], axis=1)
    return number.ravel(), points, cells


def rows(numbers, values, width=10) -> list[str]:
    pairs = zip(numbers, values, strict=True)
    return [f" -1{n:{width}d}" + "".join(f"{v:12.5E}" for v in row) for n, row in pairs]


def frd(numbers, points, cells, shapes, kind=HEXAHEDRON, name="DISP", analysis=2, width=10) -> str:
    """Node numbers of 5 or 10 digits, and up to ten nodes of an element in a line."""
    form = f"{'':37s}{width // 10}"
    lines = ["    1C", f"    2C{'':18s}{len(numbers):12d}{form}", *rows(numbers, points, width), " -3"]
    lines += [f"    3C{'':18s}{len(cells):12d}{form}"]
    for n, cell in enumerate(cells, start=1):
        digits = [f"{node:{width}d}" for node in cell]
        lines += [f" -1{n:{width}d}{kind:5d}    0    1", " -2" + "".join(digits[:10])]
        lines += [" -2" + "".join(digits[10:])] if digits[10:] else []
    lines.append(" -3")
    for n, shape in enumerate(shapes, start=1):
        lines += [f"    1PMODE{n:25d}"]
        lines += [
            f"  100CL  10{n} {10.0 * n:11.6f}{len(numbers):12d}{'':20s}{analysis:2d}{n:5d}MODAL     {width // 10:2d}"
        ]
        lines += [f" -4  {name:8s}    4    1", " -5  D1          1    2    1    0"]
        lines += [" -5  ALL         1    2    0    0    1ALL", *rows(numbers, shape, width), " -3"]
    return "\n".join([*lines, " 9999", ""])


@pytest.fixture
def model():
    numbers, points, cells = box(3, 3, 4)
    shapes = [np.round(np.sin(points + n) * 10.0**-n, 6) for n in (1, 2)]
    return numbers, points, cells, shapes


def test_shapes_of_a_solid_at_its_surface(tmp_path, model):
    numbers, points, cells, shapes = model
    (tmp_path / "m.frd").write_text(frd(numbers, points, cells, shapes) + "\n")
    found = read_shapes(tmp_path / "m.frd")
    inner = ((points > points.min(axis=0)) & (points < points.max(axis=0))).all(axis=1)
    assert len(found) == 2
    for each, shape in zip(found, shapes, strict=True):
        np.testing.assert_array_equal(each.points, points[~inner])
        np.testing.assert_allclose(each.displacement, shape[~inner], rtol=1e-5, atol=1e-12)
    # The surface is closed and encloses the volume of the box.
    a, b, c = found[0].points[found[0].triangles].transpose(1, 0, 2)
    assert np.einsum("ni,ni->", a, np.cross(b, c)) / 6.0 == pytest.approx(2 * 4 * 1.5)


SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
BRICK = np.concatenate([SQUARE, SQUARE + [0, 0, 1]])
PRISM = np.concatenate([SQUARE[[0, 1, 3]], SQUARE[[0, 1, 3]] + [0, 0, 1]])
# Nodes, corners, triangles, and the volume that these enclose or their area, of each type of element.
ELEMENTS = {1: (8, 8, 12, 1), 2: (6, 6, 8, 1 / 2), 3: (4, 4, 4, 1 / 6), 4: (20, 8, 12, 1), 5: (15, 6, 8, 1 / 2),
            6: (10, 4, 4, 1 / 6), 7: (3, 3, 1, 1 / 2), 8: (6, 3, 1, 1 / 2), 9: (4, 4, 2, 1), 10: (8, 4, 2, 1),
            11: (2, 2, 0, 0), 12: (3, 2, 0, 0)}  # fmt: skip


@pytest.mark.parametrize("width", [5, 10])
@pytest.mark.parametrize("kind", ELEMENTS)
def test_elements_of_every_type(tmp_path, kind, width):
    """Faces of solids show outwards; elements without faces count with all their nodes."""
    count, corners, triangles, content = ELEMENTS[kind]
    places = (PRISM if kind in (2, 3, 5, 6, 7, 8) else BRICK)[:corners]
    points = np.concatenate([places, np.full((count - corners, 3), 9.0)])
    shapes = [points + 1, points * 2]
    (tmp_path / "m.frd").write_text(frd(range(7, 7 + count), points, [range(7, 7 + count)], shapes, kind, width=width))
    for data, shape in zip(read_shapes(tmp_path / "m.frd"), shapes, strict=True):
        used = corners if triangles else count
        np.testing.assert_array_equal(data.points, points[:used])
        np.testing.assert_array_equal(data.displacement, shape[:used])
        a, b, c = data.points[data.triangles].transpose(1, 0, 2)
        area = np.cross(b - a, c - a) / 2
        solid = len(area) > 2
        found = np.einsum("ni,ni->", a, area) / 3 if solid else np.linalg.norm(area, axis=1).sum()
        assert (len(data.triangles), found) == (triangles, pytest.approx(content))


def test_a_single_displacement_is_a_table(tmp_path, model):
    numbers, points, cells, shapes = model
    (tmp_path / "static.frd").write_text(frd(numbers, points, cells, shapes[:1], analysis=0))
    assert read_displacement(tmp_path / "static.frd").label == "static.frd"
    (tmp_path / "modes.frd").write_text(frd(numbers, points, cells, shapes))
    with pytest.raises(FormatError, match=r"expected CalculiX's \.frd"):
        read_shapes(tmp_path / "modes.csv")
    with pytest.raises(FormatError, match=r"has 2 displacements \(1: shape 1 \(10 Hz\); 2: shape 2 \(20 Hz\)\)"):
        read_displacement(tmp_path / "modes.frd")


def test_modes_of_a_case(tmp_path, model):
    numbers, points, cells, shapes = model
    (tmp_path / "m.frd").write_text(frd(numbers, points, cells, [*shapes, shapes[0] * 3]))
    modes = {"file": "m.frd", "shapes": [3, 1], "amplitudes": ["t", 2]}
    case = case_of({"boundary": [{"motion": {"modes": modes}}]}, tmp_path)
    assert case.files == (tmp_path / "m.frd",)
    (step,) = case.case.boundaries[0].motion.steps
    assert isinstance(step, Modes)
    np.testing.assert_allclose(step.shapes[0].displacement, 3 * step.shapes[1].displacement, rtol=2e-5, atol=1e-9)
    (tmp_path / "a.csv").write_text("t,q1,q2,q3\n0,1,2,3\n1,4,5,6\n")
    modes["amplitudes"] = {"file": "a.csv"}
    (step,) = case_of({"boundary": [{"motion": {"modes": modes}}]}, tmp_path).case.boundaries[0].motion.steps
    np.testing.assert_array_equal(step.amplitudes.values, [[3, 1], [6, 4]])


BAD_MODES = {
    "shapes = [3]; expected numbers from 1 to 2": {"file": "m.frd", "shapes": [3]},
    "shapes = [true]": {"file": "m.frd", "shapes": [True]},
    "2 amplitudes for 1 shapes": {"file": "m.frd", "shapes": [1], "amplitudes": [1, 2]},
}


@pytest.mark.parametrize("message", BAD_MODES)
def test_modes_that_do_not_fit_are_refused(tmp_path, model, message):
    (tmp_path / "m.frd").write_text(frd(*model))
    with pytest.raises(CaseError) as refusal:
        case_of({"boundary": [{"motion": {"modes": {"amplitudes": [1, 1], **BAD_MODES[message]}}}]}, tmp_path)
    assert message in str(refusal.value)


DAMAGE = {
    "does not end with 9999": lambda text: text[:-6],
    "a block has 35 lines, 36 are announced": lambda text: text.replace(text.splitlines()[2] + "\n", "", 1),
    "does not hold a number and 3 values": lambda text: text.replace("1.00000E+00", "1.0000xE+00", 1),
    "has the form 2; expected text": lambda text: text.replace(f"{'':37s}1", f"{'':37s}2", 1),
    "an element has the unknown type 17": lambda text: text.replace("    1    0    1\n -2", "   17    0    1\n -2", 1),
    "has 7 nodes, not 8": lambda text: text.replace(f"{47:10d}{59:10d}{23:10d}", f"{47:10d}{59:10d}", 1),
    "a block has no end": lambda text: text.replace(" -3", " -1", 3).rsplit(" -3", 1)[0] + " 9999\n",
    "complex displacements": lambda text: text.replace("DISP ", "DISPI", 1),
    "has no displacements of nodes": lambda text: text.replace("DISP ", "FORC "),
    "two nodes have the number 11": lambda text: text.replace(" -1        14", " -1        11"),
    "has no nodes": lambda text: " 9999\n",
}  # fmt: skip


@pytest.mark.parametrize("message", DAMAGE)
def test_damaged_files_are_refused(tmp_path, model, message):
    text = frd(*model)
    broken = DAMAGE[message](text)
    assert broken != text
    (tmp_path / "m.frd").write_text(broken)
    with pytest.raises(FormatError) as refusal:
        read_shapes(tmp_path / "m.frd")
    assert message in str(refusal.value)
    assert "m.frd" in str(refusal.value)


def test_nodes_without_displacement(tmp_path, model):
    """Of a surface they are named; of beams the nodes that have all displacements remain."""
    numbers, points, cells, shapes = model
    for kind, own in ((HEXAHEDRON, cells), (11, [[11, 14]])):
        head, tail = frd(numbers, points, own, shapes, kind).rsplit("   36     ", 1)
        line = rows([11], shapes[1][:1])[0] + "\n"
        assert line in tail
        (tmp_path / "m.frd").write_text(head + "   35     " + tail.replace(line, "", 1))
        if kind == HEXAHEDRON:
            with pytest.raises(FormatError, match=r"shape 2 \(20 Hz\) has no displacement at 1 nodes .*, first 11$"):
                read_shapes(tmp_path / "m.frd")
    for data, shape in zip(read_shapes(tmp_path / "m.frd"), shapes, strict=True):
        np.testing.assert_array_equal(data.points, points[1:])
        np.testing.assert_allclose(data.displacement, shape[1:], rtol=1e-5, atol=1e-12)
