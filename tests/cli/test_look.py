"""The commands that look at grids: info, quality, compare, plot, methods; and sample."""

import json
import re

import numpy as np
import pytest
from expected import entries, text
from grids import frame

from meshdeform_core.grid import Field, Grid
from meshdeform_core.methods import ALIASES, CATALOGUE
from meshdeform_formats import read_grid, write_grid


@pytest.fixture
def grids(bench):
    """The bench with a grid that is left-handed and has collapsed edges, one that is a cell thick, and one of a single
    block with fields."""
    grid = read_grid("grid.xyz")
    points = grid.points.copy()
    grid.block(0, points)[:, :, 0] = grid.block(0, points)[:, :1, 0]
    points[:, 0] *= -1
    write_grid(grid.moved(points), "other.xyz")
    thin = frame(4, 1)
    write_grid(thin.moved(np.roll(thin.points, 1, axis=1)), "thin.xyz")
    fields = tuple(Field(name, "node", 0, np.zeros((5, 5, 4))) for name in ("p", "T"))
    write_grid(Grid.from_blocks([grid.block(0)], fields=fields), "one.vts")
    return bench


@pytest.mark.parametrize(("command", "screen", "code"), entries("screens.txt"))
def test_what_commands_say(command, screen, code, grids, call):
    result = call(*command.split())
    assert (result.out, result.code, result.err) == (screen, int(code), "")


# info


def rounded(facts):
    """To nine digits, as sums may differ in the last ones."""
    if isinstance(facts, dict | list):
        return {k: rounded(v) for k, v in facts.items()} if isinstance(facts, dict) else [rounded(v) for v in facts]
    return float(f"{facts:.9g}") if isinstance(facts, float) else facts


@pytest.mark.parametrize("name", ["grid.cgns", "other.xyz"])
def test_info_for_programs(name, grids, call):
    result = call("info", name, "--json")
    facts = rounded(json.loads(result.out))
    assert (facts, result.err) == (rounded(json.loads(text(f"info_{name}.json"))), "")
    grid = read_grid(name)
    for each in facts["interfaces"]:
        own, donor = (grid.block(grid.names.index(name)) for name in each["blocks"])
        for end in ("first", "last"):
            here, there = (tuple(n - 1 for n in each[key]) for key in (end, f"donor_{end}"))
            np.testing.assert_array_equal(own[here], donor[there])


# quality


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
    for tolerance, code in (("6e-3", 0), ("4e-3", 1)):
        assert call("compare", "grid.xyz", "other.xyz", "--tolerance", tolerance).code == code


# plot


@pytest.mark.parametrize(
    ("suffix", "begins", "options"),
    [
        (".svg", b"<?xml", ("--plane", "j=mid", "--metric", "volume", "--zoom", "worst", "--title", "x < y & z")),
        (".pdf", b"%PDF-", ("--plane", "z=0.4", "--zoom", "walls", "--range", "0.5,1", "--metric", "wall_distance")),
        (".PNG", b"\x89PNG\r\n", ("--reference", "grid.xyz", "--metric", "volume_ratio", "--log", "--plane", "k=2")),
        (
            ".svg",
            b"<?xml",
            ("--reference", "grid.xyz", "--select", "body", "--metric", "displacement", "--view", "1,1,0.5"),
        ),
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
