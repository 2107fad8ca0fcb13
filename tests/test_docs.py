"""The documentation is run: commands with their printed results, Python code, case files, option names."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
import site_reference
from site_pages import blocks, expected_outcomes, made, pictures

import meshdeform
from meshdeform_cli.main import cli, run
from meshdeform_formats.case import read_case
from meshdeform_formats.report.schema import report_schema

OWN_URL = re.compile(r"https://github\.com/meshdeform/meshdeform/blob/main/")
ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
LONG = ("tutorial.md", "series.md", "structural_table.md", "derivatives.md")
"""Pages whose commands take as long as those of all others together."""
EACH_PAGE = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


def assert_printed(expected: list[str], printed: str) -> None:
    """The lines in their order; ``...`` stands for any lines."""
    rest = printed.splitlines()
    skip = False
    for line in expected:
        if line == "...":
            skip = True
            continue
        at = rest.index(line) if skip and line in rest else 0
        assert rest[at : at + 1] == [line], f"the page says {line!r}; printed was\n{printed}"
        rest, skip = rest[at + 1 :], False
    assert skip or not expected or not rest, f"printed was more:\n{printed}"


def missing_extras(code: str) -> list[str]:
    """Optional packages that a block of code imports and that are not installed."""
    return [name for name in ("jax", "openmdao") if f"import {name}" in code and not find_spec(name)]


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=pytest.mark.slow) if page.name in LONG else page for page in PAGES],
    ids=[page.name for page in PAGES],
)
@pytest.mark.timeout(240)
def test_commands_and_code_do_what_the_page_says(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "page"}
    for language, text in blocks(page):
        if language == "console":
            for arguments, code, lines in expected_outcomes(text):
                assert run(arguments) == code, f"{arguments}: {capsys.readouterr().err}"
                captured = capsys.readouterr()
                # Which page is the first to compile a loop is nobody's business.
                err = re.sub("meshdeform: compiling [0-9]+ loops? in .*\n", "", captured.err)
                assert_printed(lines, captured.out + err)
        elif language == "python" and not missing_extras(text):
            exec(compile(text, str(page), "exec"), names)
    for picture in pictures(page):
        assert len(made(picture, tmp_path)) == 1, f"no command of {page.name} draws {picture.name}"


SCRIPTS = [(page, text) for page in PAGES for language, text in blocks(page) if language in ("sh", "bash")]
MAKEFILES = [(page, text) for page in PAGES for language, text in blocks(page) if language == "make"]


@pytest.fixture
def workshop(tmp_path, monkeypatch):
    """A folder with the files that the pages speak of, and ``meshdeform`` and ``python`` on the search path."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    assert run(["sample", "cascade", "-o", ".", "--size", "4"]) == 0
    return tmp_path


def called(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)


@pytest.mark.parametrize(
    ("page", "text"),
    # Each starts the program several times; the shortest shows that such scripts work at all.
    [pytest.param(*found, marks=() if "case $code" in found[1] else pytest.mark.slow) for found in SCRIPTS],
    ids=[f"{page.stem}-{n}" for n, (page, _) in enumerate(SCRIPTS)],
)
def test_shell_scripts_run(page, text, workshop):
    before = set(workshop.iterdir())
    done = called("bash", "-e", "-c", text)
    assert done.returncode == 0, done.stderr
    assert done.stdout or set(workshop.iterdir()) > before
    assert not list(workshop.glob("*.invalid.*"))


@pytest.mark.slow
@pytest.mark.parametrize("shell", [("sh",), ("bash", "-e")], ids=" ".join)
def test_the_shell_idiom_tells_all_outcomes_apart(shell, workshop):
    (text,) = (text for _, text in SCRIPTS if "case $code" in text)
    assert "valid: new.cgns" in called(*shell, "-c", text).stdout
    # A bar that turns by 170 degrees in one step crosses its surroundings.
    far = text.replace("-c case.toml", "-c case.toml -m tfi --steps 1 --repair off -s constants.angle=170")
    done = called(*shell, "-c", far)
    assert (done.returncode, "new.invalid.cgns" in done.stdout) == (0, True), done.stderr
    assert (workshop / "new.invalid.cgns").exists()
    assert called(*shell, "-c", text.replace("grid.cgns", "missing.cgns")).returncode == 2


@pytest.mark.slow
@pytest.mark.parametrize(("page", "text"), MAKEFILES, ids=[page.stem for page, _ in MAKEFILES])
def test_makefiles_do_not_take_an_invalid_grid_for_done(page, text, workshop):
    # Repaired, no angle would be too large.
    (workshop / "Makefile").write_text(text.replace("--force -q", "--force -q --repair off"))
    assert called("make", "turned-10.cgns").returncode == 0
    assert "up to date" in called("make", "turned-10.cgns").stdout
    for _ in range(2):
        failed = called("make", "turned-170.cgns")
        assert failed.returncode == 2
        assert "Error 3" in failed.stderr
        assert not (workshop / "turned-170.cgns").exists()
    assert (workshop / "turned-170.invalid.cgns").exists()


@EACH_PAGE
def test_case_files_are_accepted(page, tmp_path):
    (tmp_path / "displacement.csv").write_text("x,y,z,dx,dy,dz\n0,0,0,0,0,0\n")
    for number, (language, text) in enumerate(blocks(page)):
        # Sequences of files need as many files as they have times.
        if language == "toml" and "files = " not in text:
            case = tmp_path / f"{number}.toml"
            case.write_text(text)
            read_case(case)


@EACH_PAGE
def test_mentioned_options_exist(page):
    words = re.sub(r"\\\n", " ", page.read_text(encoding="utf-8"))
    for name, rest in re.findall(r"meshdeform ([a-z]+)((?: [^\n`|;&]*)?)", words):
        if name not in cli.list_commands(None):
            continue
        command = cli.get_command(None, name)
        known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
        for option in re.findall(r"(?<=\s)--?[a-z][a-z-]*", rest):
            assert option in known | {"--help", "-h"}, f"{page.name}: meshdeform {name} has no option {option}"


@EACH_PAGE
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8")):
        if own := OWN_URL.match(target):
            assert (ROOT / target[own.end() :]).exists(), f"{page.name}: {target}"
        elif not target.startswith("http"):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_generated_reference_has_every_name_command_and_key():
    page = site_reference.python_page()
    for name in meshdeform.__all__:
        assert name.startswith("__") or f"\n## {name}\n" in page
    assert "### Mesh.deform" in page
    for name in ("## meshdeform.compat.idwarp", "### USMesh", "#### USMesh.warpMesh", "## meshdeform.openmdao"):
        assert f"\n{name}\n" in page
    commands = site_reference.command_page()
    for name in cli.list_commands(None):
        assert f"\n## {name}\n" in commands
    schema = site_reference.schema_page()
    for key in report_schema()["properties"]:
        assert f"| `{key}` |" in schema
    links = set(re.findall(r"\]\(#([^)]*)\)", schema))
    headings = {heading.lower() for heading in re.findall(r"^## (.*)$", schema, re.MULTILINE)}
    assert links
    assert links <= headings  # the site gives headings their names in small letters


def test_pages_are_in_the_table_of_contents():
    contents = (ROOT / "docs" / "mkdocs.yml").read_text()
    for page in (ROOT / "docs").rglob("*.md"):
        name = page.relative_to(ROOT / "docs").as_posix()
        assert f": {name}" in contents, name
