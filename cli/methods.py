"""``meshdeform methods``: what there is to choose from."""

from __future__ import annotations

import dataclasses
import inspect
import json

import click


@click.command("methods")
@click.argument("name", required=False)
def command(name: str | None) -> int:
    """List the methods, or explain NAME: parameters, defaults, what it is good for and where it fails.

    \b
    Examples:
      meshdeform methods
      meshdeform methods idw-tfi
    """
    from meshdeform_core.methods import ALIASES, CATALOGUE, entry_of, reason_of

    if name is None:
        for key, entry in CATALOGUE.items():
            alias = next((f" (= {a})" for a, full in ALIASES.items() if full == key), "")
            click.echo(f"{key}{alias}\n    {entry.summary}")
        click.echo("\nmeshdeform methods NAME explains one of them.")
        return 0
    entry = entry_of(name)
    click.echo(f"{ALIASES.get(name, name)}: {entry.summary}\n\n{entry.advice}")
    for part in entry.parts:
        click.echo(f"\n[method.{part.__name__.lower()}]\n{inspect.cleandoc(part.__doc__ or '')}\n\ndefaults")
        for field in dataclasses.fields(part):
            click.echo(f"  {field.name} = {json.dumps(field.default)}  ({reason_of(field)})")
    return 0
