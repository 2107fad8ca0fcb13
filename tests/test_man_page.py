"""The manual page says what the commands' own help says, and man renders it without complaint."""

from __future__ import annotations

import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
from man_page import PAGE, man_page

from meshdeform_cli.main import cli

ROOT = Path(__file__).parents[1]


def test_it_is_that_of_the_commands():
    assert PAGE.read_text(encoding="utf-8") == man_page(), "run: python docs/man_page.py"


def test_it_is_installed_where_man_looks():
    files = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["data-files"]
    assert files == {"share/man/man1": [str(PAGE.relative_to(ROOT))]}


@pytest.mark.skipif(shutil.which("man") is None, reason="man is not installed")
def test_man_renders_it():
    done = subprocess.run(
        ["man", "--warnings", "-l", str(PAGE)], capture_output=True, text=True, check=True,
        env={"PATH": "/usr/bin:/bin", "MANWIDTH": "120", "LC_ALL": "C.UTF-8"},
    )  # fmt: skip
    assert done.stderr == ""
    for name in cli.list_commands(None):  # type: ignore[arg-type]
        assert f"meshdeform {name}" in done.stdout
    # What click would fold into a paragraph keeps its lines, and dashes are dashes.
    assert "\n           meshdeform info grid.vts --json\n" in done.stdout
    assert "--min-jacobian R" in done.stdout
