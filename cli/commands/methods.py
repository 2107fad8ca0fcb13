"""``meshdeform methods``: the available methods."""

from __future__ import annotations

import json
import textwrap

import click

_WIDTH = 100


@click.command("methods")
@click.argument("name", required=False)
def command(name: str | None) -> int:
    """List the methods, or explain NAME: parameters, defaults, strengths and limits.

    \b
    Examples:
      meshdeform methods
      meshdeform methods idw-tfi
    """
    from meshdeform_core.methods import ALIASES, CATALOGUE, declared, description, entry_of

    if name is None:
        for key, entry in CATALOGUE.items():
            alias = next((f" (= {a})" for a, full in ALIASES.items() if full == key), "")
            click.echo(f"{key}{alias}\n    {entry.summary}")
        click.echo("\nmeshdeform methods NAME explains one of them.")
        return 0
    entry = entry_of(name)
    click.echo(f"{ALIASES.get(name, name)}: {entry.summary}\n\n{_prose(entry.advice)}")
    for part in entry.parts:
        # Its section of the case file: a description, then every option with default, meaning and reason.
        lines = [f"\n[method.{part.__name__.lower()}]"]
        lines += [_prose(paragraph) + "\n" for paragraph in description(part).split("\n\n")]
        options = list(declared(part).values())
        for option, before in zip(options, [None, *options[:-1]], strict=True):
            lines.append(f"  {option.name} = {json.dumps(option.default)}")
            if before is None or before.meaning != option.meaning:
                alike = ", ".join(other.name for other in options if other.meaning == option.meaning)
                meaning = f"{alike}: {option.meaning}" if alike != option.name else option.meaning
                lines.append(_prose(meaning, "      "))
            lines.append(_prose(f"default: {option.why}", "      "))
        click.echo("\n".join(lines))
    return 0


def _prose(text: str, indent: str = "") -> str:
    """Plain text without markup, wrapped."""
    plain = " ".join(text.replace("``", "").split())
    return textwrap.fill(plain, _WIDTH, initial_indent=indent, subsequent_indent=indent)
