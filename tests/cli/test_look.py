"""The commands that look at grids: info, quality, compare, plot, methods; and sample."""

import json
import re

import numpy as np
import pytest

from meshdeform_core.methods import ALIASES, CATALOGUE, declared
from meshdeform_formats import read_grid, write_grid
from meshdeform_samples import SAMPLES

# info


def test_info_for_people(bench, call):
    result = call("info", "grid.cgns")
    assert (result.code, result.err) == (0, "")
    for line in (
        "grid.cgns: cgns (container=HDF5), float64",
        "3-D, 8 blocks, 1,152 nodes (960 unique), 600 cells",
        "extent x -2..2  y -2..2  z 0..1, shortest edge on a block face 0.136",
        "  block1  5 x 5 x 4  right-handed  x -2..-0.5  y -2..-0.5  z 0..1",
        "  block1.imax-block4.imin  (5, 1, 1)..(5, 5, 4)  transform [1, 2, 3]",
        "interfaces (8 found, 0 declared in the file)",
    ):
        assert line in result.out.splitlines(), result.out
    # Blocks meet the bar with 4 to 6 cells, three layers high; the first cells are those of ``stretched``.
    rows = re.findall(r"^  (\w+ \(.*?\)) +(\w+) +(\d+) +(\d+)  (\S+ \S+) +x (.*)", result.out, re.MULTILINE)
    assert rows == [
        ("body (4 faces)", "wall", "60", "4", "0.167, 0.327", "-0.5..0.5  y -0.5..0.5  z 0..1"),
        ("span (2 patches)", "symmetry", "400", "30", "0.333, 0.333", "-2..2  y -2..2  z 0..1"),
        ("outer (2 patches)", "far", "180", "16", "0.262, 0.298", "-2..2  y -2..2  z 0..1"),
    ]
    assert "body  (body, BCWall)" in call("info", "grid.cgns", "-v").out
    # Without patches roles are guessed, and long lists cut.
    texts = [call("info", "grid.xyz", *more).out for more in ((), ("-v",))]
    every = [f"{role}?" for role in ["wall"] * 4 + ["end"] * 16 + ["far"] * 12]
    assert [re.findall(r"^  block\S+ +(\w+\?)", text, re.MULTILINE) for text in texts] == [every[:22], every]
    assert ["  ... and 10 more (-v shows all)\n" in text for text in texts] == [True, False]


def test_info_for_programs(bench, call):
    result = call("info", "grid.cgns", "--json")
    facts = json.loads(result.out)
    assert result.err == ""
    assert set(facts) == {
        "file", "format", "dimension", "nodes", "unique_nodes", "cells", "bounding_box", "shortest_face_edge",
        "thin_direction", "blocks", "surfaces", "faces", "patches", "interfaces", "declared_connections",
        "external_faces", "collapsed", "fields", "notes",
    }  # fmt: skip
    assert facts["blocks"][0] == {
        "name": "block1", "nodes": [5, 5, 4], "handedness": "right", "bbox": [[-2.0, -2.0, 0.0], [-0.5, -0.5, 1.0]]
    }  # fmt: skip
    for face in facts["faces"]:
        assert face["role"] == {None: "interface", "body": "wall", "outer": "far", "span": "symmetry"}[face["family"]]
        assert face["outside"] is (face["role"] != "interface")
    assert sum(f["area"] for f in facts["faces"] if f["family"] == "body") == pytest.approx(4.0)
    assert sum(s["quads"] for s in facts["surfaces"]) == sum(facts["external_faces"].values())
    grid = read_grid("grid.cgns")
    for each in facts["interfaces"]:
        own, donor = (grid.block(grid.names.index(name)) for name in each["blocks"])
        for end in ("first", "last"):
            here, there = (tuple(n - 1 for n in each[key]) for key in (end, f"donor_{end}"))
            np.testing.assert_array_equal(own[here], donor[there])
    counts = {p["family"]: 0 for p in facts["patches"]}
    for patch, window in ((p, w) for p in facts["patches"] for w in p["windows"]):
        counts[patch["family"]] += np.prod(np.subtract(window["last"], window["first"]))
        assert min(window["first"]) >= 1
    assert counts == {s["name"]: s["quads"] for s in facts["surfaces"]}


def test_info_names_left_handed_blocks_and_collapsed_edges(bench, call):
    grid = read_grid("grid.xyz")
    points = grid.points.copy()
    grid.block(0, points)[:, :, 0] = grid.block(0, points)[:, :1, 0]
    points[:, 0] *= -1
    write_grid(grid.moved(points), "other.xyz")
    facts = json.loads(call("info", "other.xyz", "--json").out)
    assert {b["handedness"] for b in facts["blocks"]} == {"left"}
    flat, edges = (
        ("no area", "block1.kmin", 16),
        [("a collapsed edge", f"block1.{side}", 4) for side in ("imin", "imax")],
    )
    assert [(each["what"], each["face"], each["quads"]) for each in facts["collapsed"]] == [flat, *edges]
    assert "left-handed" in call("info", "other.xyz").out


# quality


def test_quality_of_a_grid_alone_and_of_folded_cells_which_are_inherited(bench, call):
    grid, sound = read_grid("grid.xyz"), json.loads(call("quality", "grid.xyz", "--json").out)["quality"]["after"]
    assert (sound["f_skew"]["min"], sound["total_volume"]) == pytest.approx((1.0, 15.0))
    assert sound["wall_normal_deviation_deg"] is None
    points = grid.points.copy()
    grid.block(0, points)[2, 2, 2] += [0.0, 0.0, 0.9]
    write_grid(grid.moved(points), "folded.xyz")
    judged = call("quality", "folded.xyz", "--json")
    alone = json.loads(judged.out)
    assert (judged.code, judged.err, alone["valid"]) == (0, "", True)
    assert alone["quality"]["after"]["inherited_invalid_cells"] > 0
    result = call("quality", "folded.xyz", "--reference", "grid.xyz", "--json")
    assert result.code == 3
    report = json.loads(result.out)
    assert report["quality"]["after"]["invalid_cells"] == alone["quality"]["after"]["inherited_invalid_cells"]
    assert report["invalid_cells"][0]["block"] == "block1"


# compare


def test_compare_says_how_far_and_where(bench, call):
    grid = read_grid("grid.xyz")
    points = grid.points.copy()
    grid.block(2, points)[1, 3, 2] += [0.0, 3e-3, 4e-3]
    write_grid(grid.moved(points), "other.xyz")
    facts = json.loads(call("compare", "grid.xyz", "other.xyz", "--json").out)
    assert facts["largest"] == pytest.approx(5e-3)
    assert facts["rms"] == pytest.approx(5e-3 / np.sqrt(1152))
    assert (facts["where"], facts["differing_nodes"]) == ("block3 (2, 4, 3)", 1)
    assert [b["largest"] > 0 for b in facts["blocks"]] == [n == 2 for n in range(8)]
    for other, tolerance, code in (("other.xyz", "6e-3", 0), ("other.xyz", "4e-3", 1), ("grid.cgns", "0", 0)):
        assert call("compare", "grid.xyz", other, "--tolerance", tolerance).code == code
    lines = call("compare", "grid.xyz", "other.xyz").out.splitlines()
    assert lines[:2] == ["largest 5.000000e-03 at block3 (2, 4, 3)", "rms     1.473139e-04, 1 of 1,152 nodes differ"]


# plot


@pytest.mark.parametrize(
    ("suffix", "begins", "options"),
    [
        (".svg", b"<?xml", ("--plane", "j=mid", "--metric", "volume", "--zoom", "worst", "--title", "x < y & z")),
        (".pdf", b"%PDF-", ("--plane", "z=0.4", "--zoom", "walls", "--range", "0.5,1", "--metric", "wall_distance")),
        (".PNG", b"\x89PNG\r\n", ("--reference", "grid.xyz", "--metric", "volume_ratio", "--log", "--select", "body")),
    ],
)
def test_plot_options(suffix, begins, options, bench, call):
    command = ("plot", "grid.cgns", "-o", f"picture{suffix}", *options, "-q")
    result = call(*command)
    assert (result.code, result.out, result.err) == (0, "", "")
    content = (bench / f"picture{suffix}").read_bytes()
    assert content.startswith(begins)
    title = b"x &lt; y &amp; z" if "--title" in options else b"grid.cgns"
    assert suffix != ".svg" or title in content
    assert call(*command).code == 2


# methods


def test_methods_lists_and_explains_all(call):
    listed = call("methods").out
    for name in (*ALIASES, *CATALOGUE):
        assert name in listed
        text, entry = call("methods", name).out, CATALOGUE[ALIASES.get(name, name)]
        assert text.startswith(f"{ALIASES.get(name, name)}: {entry.summary}\n")
        for part in entry.parts:
            section = text.partition(f"\n[method.{part.__name__.lower()}]\n")[2].partition("\n[method.")[0]
            words, options = " ".join(section.split()), list(declared(part).values())
            for option in options:
                assert f"\n  {option.name} = {json.dumps(option.default)}\n" in section
                assert " ".join(f"default: {option.why}".replace("``", "").split()) in words
                # What several options mean is said once, with the names of all of them.
                alike = [each.name for each in options if each.meaning == option.meaning]
                meaning = f"{', '.join(alike)}: {option.meaning}" if len(alike) > 1 else option.meaning
                assert words.count(" ".join(meaning.replace("``", "").split())) == 1


# sample


def test_sample_lists_all(call):
    result = call("sample")
    assert result.code == 0
    assert [line for line in result.out.splitlines() if not line.startswith(" ")] == list(SAMPLES)
    assert result.out.count("--size: ") == len(SAMPLES)


def test_sample_overwrites_only_by_force(bench, call, snapshot):
    arguments = ("sample", "wing", "-o", "new/folder", "--size", "8")
    assert call(*arguments).code == 0
    before = snapshot(bench)
    for name in ("grid.cgns", "structure.npz", ""):
        result = call(*arguments)
        assert (result.code, f"error: new/folder/{name}" in result.err) == (2, True)
        assert "exists; use --force to overwrite it" in result.err
        (bench / "new/folder" / (name or "case.toml")).unlink()
    assert call(*arguments, "--force").code == 0
    assert snapshot(bench) == before
    assert (bench / "new/folder/README.md").is_file()
