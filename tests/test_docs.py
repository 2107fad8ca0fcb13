"""The documentation is run: commands with their printed results, code, notebooks, case files. What it names exists, the
manual page is that of the commands, and the check of the built site finds what a reader would stumble over."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import man_page
import pytest
import site_reference
from site_pages import blocks, expected_outcomes, made, pictures

import meshdeform
from meshdeform_cli.main import cli, run
from meshdeform_formats.case import read_case

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
        elif language == "python":
            if any(f"import {name}" in text and not find_spec(name) for name in ("jax", "openmdao")):
                continue  # an extra that is not installed
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


def test_generated_reference_has_every_name_and_command():
    page = site_reference.python_page()
    for name in meshdeform.__all__:
        assert name.startswith("__") or f"\n## {name}\n" in page
    assert "### Mesh.deform" in page
    for name in ("## meshdeform.compat.idwarp", "### USMesh", "#### USMesh.warpMesh", "## meshdeform.openmdao"):
        assert f"\n{name}\n" in page
    commands = site_reference.command_page()
    for name in cli.list_commands(None):
        assert f"\n## {name}\n" in commands


def test_pages_are_in_the_table_of_contents():
    contents = (ROOT / "docs" / "mkdocs.yml").read_text()
    for page in (ROOT / "docs").rglob("*.md"):
        name = page.relative_to(ROOT / "docs").as_posix()
        assert f": {name}" in contents, name


TROUBLES = (ROOT / "docs" / "troubleshooting.md").read_text()
ROWS = [line.split(" | ")[0] for line in TROUBLES.splitlines() if line.startswith("| `")]
QUOTED = sorted({quote for row in ROWS for quote in re.findall(r"`([^`]+)`", row)})
# What the system says, or click.
FOREIGN = {os.strerror(number) for number in (errno.ENOSPC, errno.EFBIG, errno.EACCES, errno.ENOENT)} | {"No such file"}
NO_MESSAGES = {"OUT", ".invalid"}


def texts() -> str:
    """The sources of the program; strings that are continued in the next line are joined."""
    folders = ("cli", "formats", "meshdeform", "meshdeform_core", "sample_cases")
    sources = [path.read_text(encoding="utf-8") for folder in folders for path in (ROOT / folder).rglob("*.py")]
    return re.sub(r'"\n *f?"', "", "\n".join(sources))


def test_messages_that_the_page_quotes_exist():
    assert len(QUOTED) > 30
    source = texts()
    quoted = [quote for quote in QUOTED if quote not in FOREIGN | NO_MESSAGES]
    parts = [(quote, part.strip()) for quote in quoted for part in re.split(r"\.\.\.|\bN\b", quote)]
    # Single words between what is filled in may be filled in themselves.
    assert [quote for quote, part in parts if len(part) > 3 and part not in source] == []


NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_runs_without_jupyter(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    names: dict[str, object] = {}
    for number, cell in enumerate(notebook["cells"]):
        # Outputs are made by whoever runs it; in the repository they would grow stale.
        assert cell["cell_type"] == "markdown" or not cell["outputs"]
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), f"{path.name}, cell {number}", "exec"), names)


def test_the_manual_page_is_that_of_the_commands():
    assert man_page.PAGE.read_text(encoding="utf-8") == man_page.man_page(), "run: python docs/man_page.py"


def test_the_manual_page_is_installed_where_man_looks():
    files = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["data-files"]
    assert files == {"share/man/man1": [str(man_page.PAGE.relative_to(ROOT))]}


@pytest.mark.skipif(shutil.which("man") is None, reason="man is not installed")
def test_man_renders_the_manual_page():
    done = subprocess.run(
        ["man", "--warnings", "-l", str(man_page.PAGE)], capture_output=True, text=True, check=True,
        env={"PATH": "/usr/bin:/bin", "MANWIDTH": "120", "LC_ALL": "C.UTF-8"},
    )  # fmt: skip
    assert done.stderr == ""
    for name in cli.list_commands(None):  # type: ignore[arg-type]
        assert f"meshdeform {name}" in done.stdout
    # What click would fold into a paragraph keeps its lines, and dashes are dashes.
    assert "\n           meshdeform info grid.vts --json\n" in done.stdout
    assert "--min-jacobian R" in done.stdout
