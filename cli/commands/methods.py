"""``meshdeform methods``: the available methods."""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
import textwrap
from collections.abc import Iterator

import click

from .. import completion

_WIDTH = 100


@click.command("methods")
@click.argument("name", required=False, shell_complete=completion.methods)
def command(name: str | None) -> int:
    """List the methods, or explain NAME: parameters, defaults, strengths and limits.

    \b
    Examples:
      meshdeform methods
      meshdeform methods idw-tfi
    """
    from meshdeform_core.methods import ALIASES, CATALOGUE, entry_of

    if name is None:
        for key, entry in CATALOGUE.items():
            alias = next((f" (= {a})" for a, full in ALIASES.items() if full == key), "")
            click.echo(f"{key}{alias}\n    {entry.summary}")
        click.echo("\nmeshdeform methods NAME explains one of them.")
        return 0
    entry = entry_of(name)
    click.echo(f"{ALIASES.get(name, name)}: {entry.summary}\n\n{_prose(entry.advice)}")
    for part in entry.parts:
        click.echo("\n".join(_part_lines(part)))
    return 0


def _part_lines(part: type) -> Iterator[str]:
    """A method's section of the case file: its description, then every option with default, meaning and reason."""
    from meshdeform_core.methods import reason_of

    text, _, attributes = inspect.cleandoc(part.__doc__ or "").partition("Attributes\n----------\n")
    yield f"\n[method.{part.__name__.lower()}]"
    yield from (_prose(paragraph) + "\n" for paragraph in text.strip().split("\n\n"))
    meanings = _meanings(attributes)
    for field in dataclasses.fields(part):
        names = next((names for names in meanings if field.name in names), ())
        yield f"  {field.name} = {json.dumps(field.default)}"
        if names and names[0] == field.name:
            shared = f"{', '.join(names)}: " if len(names) > 1 else ""
            yield _prose(shared + meanings[names], "      ")
        yield _prose(f"default: {reason_of(field)}", "      ")


def _meanings(attributes: str) -> dict[tuple[str, ...], str]:
    """The attributes section of a docstring, as texts keyed by the names that each entry explains."""
    found: dict[tuple[str, ...], str] = {}
    for entry in re.split(r"\n(?=\S)", attributes.strip()):
        names, colon, text = entry.partition(" : ")
        if colon:
            found[tuple(name.strip() for name in names.split(","))] = " ".join(text.split())
    return found


def _prose(text: str, indent: str = "") -> str:
    """Plain text without markup, wrapped."""
    plain = " ".join(text.replace("``", "").split())
    return textwrap.fill(plain, _WIDTH, initial_indent=indent, subsequent_indent=indent)
