"""The documentation is run: commands with their printed results, Python code, case files, option names."""

from __future__ import annotations

import importlib
import re
import shlex
from pathlib import Path

import pytest

from meshdeform_cli.main import cli, run
from meshdeform_formats.case import read_case

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
EACH_PAGE = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and text of all fenced blocks."""
    return _BLOCK.findall(page.read_text(encoding="utf-8"))


def expected_outcomes(text: str) -> list[tuple[list[str], int, list[str]]]:
    """Arguments, exit code and printed lines of every command in a console block."""
    outcomes: list[tuple[list[str], int, list[str]]] = []
    for line in text.splitlines():
        if line.startswith("$ meshdeform"):
            outcomes.append((shlex.split(line)[2:], 0, []))
        elif code := re.fullmatch(r"\[exit code (\d+)\]", line):
            outcomes[-1] = (outcomes[-1][0], int(code[1]), outcomes[-1][2])
        else:
            outcomes[-1][2].append(line)
    return outcomes


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


@EACH_PAGE
@pytest.mark.timeout(60)
def test_commands_and_code_do_what_the_page_says(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for language, text in blocks(page):
        if language == "console":
            for arguments, code, lines in expected_outcomes(text):
                assert run(arguments) == code, f"{arguments}: {capsys.readouterr().err}"
                captured = capsys.readouterr()
                assert_printed(lines, captured.out + captured.err)
        elif language == "python":
            exec(compile(text, str(page), "exec"), {"__name__": "page"})


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
        command = importlib.import_module(f"meshdeform_cli.{name}").command
        known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
        for option in re.findall(r"(?<=\s)--?[a-z][a-z-]*", rest):
            assert option in known | {"--help", "-h"}, f"{page.name}: meshdeform {name} has no option {option}"


@EACH_PAGE
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\((?!http)([^)#]+)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), f"{page.name}: {target}"
