"""The commands of a page: what they are, what they print, what they leave behind."""

from __future__ import annotations

import os
import re
import shlex
import tempfile
from pathlib import Path

_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_PICTURE = re.compile(r"\]\(((?:\.\./)*(?:docs/)?images/pages/[^)]+)\)")


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


def pictures(page: Path) -> list[Path]:
    """Pictures that the commands of a page make: those it shows from ``images/pages``."""
    return [(page.parent / link).resolve() for link in _PICTURE.findall(page.read_text(encoding="utf-8"))]


def made(picture: Path, folder: Path) -> list[Path]:
    """The files of a picture's name below the folder in which a page was run: there is to be one."""
    return sorted(folder.rglob(picture.name))


def renew_pictures(docs: Path) -> None:
    """Run every page that shows pictures of its own commands, and keep what they drew, with a palette."""
    for page in [docs.parent / "README.md", *sorted(docs.rglob("*.md"))]:
        wanted = pictures(page)
        if not wanted:
            continue
        with tempfile.TemporaryDirectory() as folder:
            run_page(page, Path(folder))
            for picture in wanted:
                (found,) = made(picture, Path(folder))
                picture.parent.mkdir(parents=True, exist_ok=True)
                shrink(found, picture)


def run_page(page: Path, folder: Path) -> None:
    """Run the console and Python blocks of a page in a folder; a wrong exit code ends it."""
    from meshdeform_cli.main import run

    here, names = Path.cwd(), {"__name__": "page"}
    os.chdir(folder)
    try:
        for language, text in blocks(page):
            if language == "python":
                exec(compile(text, str(page), "exec"), names)
            for arguments, code, _ in expected_outcomes(text) if language == "console" else ():
                if run(arguments) != code:
                    raise SystemExit(f"{page}: meshdeform {shlex.join(arguments)} did not end with {code}")
    finally:
        os.chdir(here)


def shrink(source: Path, target: Path, width: int = 1000) -> None:
    """A PNG of at most ``width`` pixels with a palette: a fifth of the size, which nobody sees."""
    from PIL import Image

    with Image.open(source) as picture:
        small = picture.convert("RGB")
        small.thumbnail((width, width), Image.Resampling.LANCZOS)
        small.quantize(128, method=Image.Quantize.MAXCOVERAGE).save(target, optimize=True)
