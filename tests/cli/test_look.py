"""The commands that look at grids: info, quality, compare, plot, methods; and sample."""

import json
import re

import numpy as np
import pytest

from meshdeform_core.methods import ALIASES, CATALOGUE
from meshdeform_formats import read_grid, write_grid
from meshdeform_samples import SAMPLES

# info


def test_info_for_people(bench, call):
    result = call("info", "grid.cgns")
    assert (result.code, result.err) == (0, "")
    for words in (
        "grid.cgns: cgns (container=HDF5), float64",
        "3-D, 8 blocks, 1,152 nodes",
        "600 cells",
        "block1  5 x 5 x 4  right-handed  x -2..-0.5  y -2..-0.5  z 0..1",
        "block1.imax-block4.imin",
        "interfaces (8 found, 0 declared in the file)",
    ):
        assert words in result.out, result.out
    # Blocks meet the bar with 4 to 6 cells, three layers high.
    assert re.search(r"^  body \(4 faces\) +wall +60 +4 +0\.\d+, 0\.\d+ +x -0\.5\.\.0\.5 +y", result.out, re.MULTILINE)
    assert re.search(r"^  span \(\d+ \w+\) +symmetry +400 +30 ", result.out, re.MULTILINE)
    assert "body  (body, BCWall)" in call("info", "grid.cgns", "-v").out


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
    assert {s["name"]: s["quads"] for s in facts["surfaces"]}.keys() == {"body", "outer", "span"}
    assert sum(s["quads"] for s in facts["surfaces"]) == sum(facts["external_faces"].values())
    assert facts["bounding_box"] == [[-2.0, -2.0, 0.0], [2.0, 2.0, 1.0]]
    # 16 lines each way without the 4 x 4 inside the bar, four layers.
    assert facts["unique_nodes"] == (16 * 16 - 4 * 4) * 4
    assert len(facts["interfaces"]) == 8
    grid = read_grid("grid.cgns")
    for each in facts["interfaces"]:
        own, donor = (grid.block(grid.names.index(name)) for name in each["blocks"])
        for end in ("first", "last"):
            here, there = (tuple(n - 1 for n in each[key]) for key in (end, f"donor_{end}"))
            np.testing.assert_array_equal(own[here], donor[there])
    assert {p["family"] for p in facts["patches"]} == {"body", "outer", "span"}
    window = facts["patches"][0]["windows"][0]
    assert window["face"].split(".")[1] in {"imin", "imax", "jmin", "jmax"}
    assert min(window["first"]) == 1
    assert facts["collapsed"] == []


def test_info_names_left_handed_blocks_and_collapsed_edges(bench, call):
    grid = read_grid("grid.xyz")
    points = grid.points.copy()
    grid.block(0, points)[:, :, 0] = grid.block(0, points)[:, :1, 0]
    points[:, 0] *= -1
    write_grid(grid.moved(points), "other.xyz")
    facts = json.loads(call("info", "other.xyz", "--json").out)
    assert {b["handedness"] for b in facts["blocks"]} == {"left"}
    assert {"face": "block1.kmin", "what": "no area", "quads": 16} in facts["collapsed"]
    assert "left-handed" in call("info", "other.xyz").out


# quality


def test_quality_of_a_grid_alone(bench, call):
    result = call("quality", "grid.xyz", "--json")
    report = json.loads(result.out)
    assert (result.code, result.err) == (0, "")
    assert report["valid"] is True
    assert report["quality"]["after"]["f_skew"]["min"] == pytest.approx(1.0)
    assert report["quality"]["after"]["total_volume"] == pytest.approx(15.0)
    assert report["quality"]["after"]["wall_normal_deviation_deg"] is None


def test_quality_of_folded_grid_is_inherited(bench, call):
    grid = read_grid("grid.xyz")
    points = grid.points.copy()
    grid.block(0, points)[2, 2, 2] += [0.0, 0.0, 0.9]
    write_grid(grid.moved(points), "folded.xyz")
    alone = json.loads(call("quality", "folded.xyz", "--json").out)
    assert alone["valid"] is True
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
    for more, code in (((), 0), (("--tolerance", "6e-3"), 0), (("--tolerance", "4e-3"), 1)):
        assert call("compare", "grid.xyz", "other.xyz", *more).code == code


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
        assert entry.summary in text
        for part in entry.parts:
            assert f"[method.{part.__name__.lower()}]" in text
            for option in part.__dataclass_fields__:
                assert re.search(rf"^  {option} = ", text, re.MULTILINE), option


# sample


def test_sample_lists_all(call):
    result = call("sample")
    assert result.code == 0
    assert [line for line in result.out.splitlines() if not line.startswith(" ")] == list(SAMPLES)
    assert result.out.count("--size: ") == len(SAMPLES)


def test_sample_overwrites_only_by_force(bench, call, snapshot):
    arguments = ("sample", "beam", "-o", "new/folder")
    assert call(*arguments).code == 0
    before = snapshot(bench)
    result = call(*arguments)
    assert (result.code, snapshot(bench)) == (2, before)
    assert "new/folder/grid.cgns exists; use --force" in result.err
    (bench / "new/folder/grid.cgns").unlink()
    assert "new/folder/case.toml exists" in call(*arguments).err
    assert call(*arguments, "--force").code == 0
    assert snapshot(bench) == before
