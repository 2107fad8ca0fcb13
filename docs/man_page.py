"""The manual page, made of the commands' own help: ``python docs/man_page.py`` writes docs/man/meshdeform.1."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import click

from meshdeform_cli.main import cli

PAGE = Path(__file__).parent / "man" / "meshdeform.1"

_EXIT = (
    ("0", "Done, and the grid is valid."),
    ("1", "An internal error; please report it."),
    ("2", "Wrong usage or wrong input; one message says what was found, what was expected, and where."),
    ("3", "Cells of the deformed grid are invalid that were valid before; it is written beside the output."),
    ("130, 143, 129", "Ended by SIGINT, SIGTERM, SIGHUP; nothing is left half-written."),
)
_ENVIRONMENT = (
    ("NO_COLOR", "If set and not empty, nothing is coloured."),
    ("NUMBA_CACHE_DIR", "Folder for compiled loops; see meshdeform warm-up."),
)


def man_page() -> str:
    """The page in the macros of man(7)."""
    return "\n".join(_lines()) + "\n"


def _lines() -> Iterator[str]:
    yield f'.TH MESHDEFORM 1 "" "meshdeform {version("meshdeform")}" "User Commands"'
    yield ".SH NAME"
    yield r"meshdeform \- deform block-structured grids and judge the result"
    yield ".SH SYNOPSIS"
    yield r"\fBmeshdeform\fR \fICOMMAND\fR [\fIARGUMENTS\fR]..."
    yield ".SH DESCRIPTION"
    root = click.Context(cli, info_name="meshdeform")
    yield from _paragraphs(cli.help or "")
    yield ".SH COMMANDS"
    for name in cli.list_commands(root):
        command = cli.get_command(root, name)
        assert command is not None
        yield from _command(name, command, root)
    for title, rows in (("EXIT STATUS", _EXIT), ("ENVIRONMENT", _ENVIRONMENT)):
        yield f".SH {title}"
        for term, meaning in rows:
            yield from (".TP", rf"\fB{_text(term)}\fR", _text(meaning))
    yield ".SH SEE ALSO"
    yield "The documentation: https://github.com/meshdeform/meshdeform/tree/main/docs"


def _command(name: str, command: click.Command, parent: click.Context) -> Iterator[str]:
    context = click.Context(command, info_name=name, parent=parent)
    usage = " ".join(_text(piece) for piece in command.collect_usage_pieces(context))
    yield f".SS meshdeform {_text(name)}"
    yield ".PP"
    yield rf"\fBmeshdeform {_text(name)}\fR {usage}"
    yield from _paragraphs(command.help or "")
    for parameter in command.params:
        record = parameter.get_help_record(context) if isinstance(parameter, click.Option) else None
        if record is not None:
            yield from (".TP", rf"\fB{_text(record[0])}\fR", _text(record[1]) or r"\&")


def _paragraphs(text: str) -> Iterator[str]:
    """Paragraphs of a help text; those after a line with a backspace keep their lines, as click has it."""
    for paragraph in re.split(r"\n\s*\n", text.strip()):
        lines = [line for line in paragraph.splitlines() if line.strip()]
        if lines and lines[0].strip() == "\b":
            yield from (".PP", _text(lines[1].strip()), ".RS 4", ".nf", *(_text(line.strip()) for line in lines[2:]))
            yield from (".fi", ".RE")
        else:
            yield from (".PP", _text(" ".join(line.strip() for line in lines)))


def _text(words: str) -> str:
    """Words with what roff would take for its own escaped."""
    words = words.replace("\\", r"\e").replace("-", r"\-").replace("`", r"\(ga").replace("'", r"\(aq")
    return rf"\&{words}" if words.startswith(".") else words


if __name__ == "__main__":
    PAGE.write_text(man_page(), encoding="utf-8")
