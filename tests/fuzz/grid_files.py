"""Classes of mutated grid files: what is accepted must be what an independent reading finds."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import Random

import numpy as np
from cgns_witness import AdfWriter, N, two_zones, write_hdf5
from plot3d_witness import ENCODINGS, ascii_file, binary_file

from meshdeform_formats import read_grid, write_grid
from meshdeform_formats.grids import complete_for_export, read_grid_with_boundaries
from meshdeform_formats.neutral_map import write_neutral_map

from . import judges, mutations
from .bench import Bench, called, picked, refusal, seeded
from .mutations import mutated

Kind = Callable[[Bench, Random], str]


def prepare(bench: Bench) -> None:
    """Write every kind of good grid file."""
    one = type(bench.grid).from_blocks([bench.grid.block(0)])
    for name, grid, options in (
        ("grid.p3dfmt", bench.grid, {"encoding": "ascii"}),
        ("grid.cgns", bench.grid, {}),
        ("grid.vts", one, {"encoding": "ascii"}),
        ("raw.vts", one, {}),
        ("grid.vtk", one, {"encoding": "ascii"}),
        ("raw.vtk", one, {"encoding": "binary"}),
        ("set.vtm", bench.grid, {"encoding": "ascii"}),
    ):
        write_grid(grid, name, options)
    AdfWriter().write(Path("grid.adf"), two_zones())
    write_neutral_map(complete_for_export(bench.grid, Path("grid.cgns")), Path("grid.nmf"))


def accepted(bad: Path, judge: Callable[..., str]) -> str:
    """A grid file that can be converted is what the judge reads."""
    code, told = called("convert", str(bad), "copy.xyz", "--force", "-q")
    if code != 0:
        return refusal(code, told)
    grid = read_grid(bad)
    if not np.array_equal(read_grid("copy.xyz").points, grid.points):
        return "the converted grid is another"
    return judge(bad, grid) or "ok"


def mutated_file(name: str, text: bool, judge: Callable[..., str], bench: Bench, rng: Random) -> str:
    good, bad = (Path(f"{stem}{Path(name).suffix}") for stem in ("good", "bad"))
    good.write_bytes(bench.valid[name])
    bad.write_bytes(mutated(bench.valid[name], text, rng))
    return accepted(bad, judge)


def neutral_map(bench: Bench, rng: Random) -> str:
    """What its connections join lies at one place, or is told."""
    Path("bad.nmf").write_bytes(mutated(bench.valid["grid.nmf"], True, rng))
    arguments = ("deform", "grid.xyz", "--boundary-file", "bad.nmf", "-c", "case.toml", "-m", "tfi")
    code, told = called(*arguments, "-o", "out.xyz", "--force", "-q")
    if code not in (0, 3):
        return refusal(code, told)
    grid = read_grid_with_boundaries(Path("grid.xyz"), Path("bad.nmf"))
    return judges.neutral_map(Path("bad.nmf"), grid, told) or "ok"


def _plot3d_parts(rng: Random):
    """Blocks, IBLANK and variant of a random small file."""
    flat = rng.random() < 0.3
    shapes = [tuple(rng.randrange(2, 6) for _ in range(3)) for _ in range(rng.randrange(1, 4))]
    variant = {
        **rng.choice(ENCODINGS),
        **picked(rng, byte_order=("little", "big"), precision=("float32", "float64")),
        "multiblock": len(shapes) > 1 or rng.random() < 0.5,
        "dimension": 2 if flat and rng.random() < 0.7 else 3,
    }
    if flat:
        shapes = [(a, b, 1) for a, b, _ in shapes]
        if variant.get("records") == "plane":
            variant["records"] = "block"
    numbers = seeded(rng)
    blocks = [numbers.uniform(-2, 2, (*shape, 3)).astype(variant["precision"]).astype(float) for shape in shapes]
    for block in blocks:
        if flat:
            block[..., 2] = 0.0
    flags = [numbers.integers(-3, 3, shape).astype(np.int32) for shape in shapes] if rng.random() < 0.4 else None
    return blocks, flags, variant


def plot3d_variants(bench: Bench, rng: Random) -> str:
    """Every variant of a binary file."""
    blocks, flags, variant = _plot3d_parts(rng)
    Path("bad.xyz").write_bytes(mutated(binary_file(blocks, flags, **variant), False, rng))
    return accepted(Path("bad.xyz"), judges.plot3d_binary)


def plot3d_texts(bench: Bench, rng: Random) -> str:
    """Plane grids, IBLANK and grids without a block count as text."""
    blocks, flags, variant = _plot3d_parts(rng)
    text = ascii_file(blocks, flags, variant["multiblock"], variant["dimension"])
    Path("bad.fmt").write_bytes(mutated(text.encode(), True, rng))
    return accepted(Path("bad.fmt"), judges.plot3d_text)


def cgns_tree(adf: bool, bench: Bench, rng: Random) -> str:
    """A tree of which a node is missing, moved, linked or of another kind."""
    tree = mutations.cgns_tree(_base_tree(rng), rng)
    bad = Path("bad.adf" if adf else "bad.cgns")
    try:
        if adf:
            version, order, chunks = rng.choice(("A02011", "B02013")), rng.choice("<>"), rng.choice((1, 1, 3))
            AdfWriter(version, order, chunks).write(bad, tree)
        else:
            write_hdf5(bad, tree, track=rng.random() < 0.7)
    except (ValueError, KeyError, TypeError, IndexError, OSError, ZeroDivisionError):
        # Two nodes of one name, or arrays that the format does not have: there is no such file.
        return "refused"
    return accepted(bad, partial(judges.cgns_tree, tree))


def _base_tree(rng: Random) -> N:
    tree = two_zones()
    if rng.random() < 0.3:
        zone = tree["Base/left"]
        zone["GridCoordinates"].children.append(N("Rind", "Rind_t", np.zeros(6, np.int32)))
        tree["Base"].children.append(N("Units", "DimensionalUnits_t", "Meter"))
    return tree


def xml_tags(bench: Bench, rng: Random) -> str:
    """A .vts in any encoding with a tag or an attribute changed; the vtk package reads it, too."""
    import vtk_witness

    ni, nj, nk = (rng.randrange(2, 5) for _ in range(3))
    points = seeded(rng).uniform(-2, 2, (ni, nj, nk, 3)).astype(rng.choice(("f4", "f8")))
    grid = vtk_witness.structured_grid(points, (rng.choice((0, 0, 2)), 0, 0))
    vtk_witness.add_array(grid.GetPointData(), "p", seeded(rng).uniform(0, 1, (ni, nj, nk)), "Scalars")
    vtk_witness.write_xml(
        Path("good.vts"),
        grid,
        **picked(
            rng,
            encoding=("ascii", "binary", "appended", "appended-base64"),
            compression=("NONE", "ZLIB", "LZMA"),
            header=("UInt32", "UInt64"),
            big_endian=(False, True),
        ),
    )
    Path("bad.vts").write_bytes(mutations.tags(Path("good.vts").read_bytes(), rng))
    return accepted(Path("bad.vts"), judges.vtk_points)


def legacy_lines(bench: Bench, rng: Random) -> str:
    """A legacy .vtk of any version with its header changed; the vtk package reads it, too."""
    import vtk_witness

    points = seeded(rng).uniform(-2, 2, (3, 2, 4, 3)).astype(rng.choice(("f4", "f8")))
    grid = vtk_witness.structured_grid(points)
    vtk_witness.add_array(grid.GetPointData(), "p", seeded(rng).uniform(0, 1, (3, 2, 4)), "Scalars")
    binary = rng.random() < 0.5
    vtk_witness.write_legacy(Path("good.vtk"), grid, binary, rng.choice((42, 51)))
    data = Path("good.vtk").read_bytes()
    at = data.index(b"\n", data.index(b"POINTS")) if binary else len(data)
    Path("bad.vtk").write_bytes(mutated(data[:at], True, rng) + data[at:])
    return accepted(Path("bad.vtk"), judges.vtk_points)


KINDS: dict[str, Kind] = {
    "plot3d, all variants": plot3d_variants,
    "plot3d ASCII, all variants": plot3d_texts,
    "CGNS, HDF5": partial(mutated_file, "grid.cgns", False, judges.cgns),
    "CGNS, ADF": partial(mutated_file, "grid.adf", False, judges.in_one_piece),
    "CGNS, HDF5, nodes": partial(cgns_tree, False),
    "CGNS, ADF, nodes": partial(cgns_tree, True),
    ".vts ASCII": partial(mutated_file, "grid.vts", True, judges.vtk_points),
    ".vts raw": partial(mutated_file, "raw.vts", False, judges.vtk_points),
    ".vts, tags": xml_tags,
    ".vtk ASCII": partial(mutated_file, "grid.vtk", True, judges.vtk_points),
    ".vtk binary": partial(mutated_file, "raw.vtk", False, judges.vtk_points),
    ".vtk, header": legacy_lines,
    ".vtm": partial(mutated_file, "set.vtm", True, judges.vtm),
    "neutral map": neutral_map,
}
