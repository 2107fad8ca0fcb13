"""Reference pages made from the program itself: options of all commands, the Python interface."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

import click

import meshdeform
from meshdeform_cli.main import cli

INTERFACES = {
    "meshdeform.compat.idwarp": (),
    "meshdeform.openmdao": ("openmdao", "mphys"),
    "meshdeform.jax": ("jax",),
}
"""Modules beside ``import meshdeform``, and what they need."""


def command_page() -> str:
    """``--help`` of every command."""
    parts = ["# All options", "What `meshdeform COMMAND --help` prints."]
    with click.Context(cli, info_name="meshdeform") as top:
        for name in cli.list_commands(top):
            command = cli.get_command(top, name)
            with click.Context(command, info_name=name, parent=top, max_content_width=100) as context:
                parts.append(f"## {name}\n\n```text\n{command.get_help(context)}\n```")
    return "\n\n".join(parts) + "\n"


def python_page() -> str:
    """Every public name of ``import meshdeform`` with its docstring."""
    parts = ["# Python", "```python\nimport meshdeform as md\n```", _text(meshdeform.__doc__ or "")]
    for name in meshdeform.__all__:
        if not name.startswith("__"):
            parts += _object(name, getattr(meshdeform, name), "##")
    for module in INTERFACES:
        parts += _interface(module)
    return "\n\n".join(parts) + "\n"


def _interface(name: str) -> Iterator[str]:
    """A module with everything that it offers; only its summary where the extra that it needs is not installed."""
    yield f"## {name}"
    if not all(map(find_spec, INTERFACES[name])):
        yield f"Needs {' and '.join(INTERFACES[name])}."
        return
    module = importlib.import_module(name)
    yield _text(inspect.getdoc(module) or "")
    for each in module.__all__:
        yield from _object(each, getattr(module, each), "###")


def _object(name: str, thing: Any, level: str) -> Iterator[str]:
    yield f"{level} {name}"
    if callable(thing) and not (inspect.isclass(thing) and issubclass(thing, Exception)):
        yield f"```python\n{name}{_signature(thing)}\n```"
    yield _text(inspect.getdoc(thing) or "")
    if inspect.isclass(thing) and thing.__module__.startswith("meshdeform."):
        for member, value in _members(thing).items():
            if not member.startswith("_") and value.__doc__:
                yield from _member(f"{name}.{member}", value, f"{level}#")


def _members(thing: type) -> dict[str, Any]:
    """What a class defines, with what it has from private bases."""
    own = [each for each in thing.__mro__ if each is thing or each.__name__.startswith("_")]
    return {name: value for each in own for name, value in vars(each).items()}


def _member(name: str, value: Any, level: str) -> Iterator[str]:
    yield f"{level} {name}"
    function = value.__func__ if isinstance(value, classmethod | staticmethod) else value
    if inspect.isfunction(function):
        yield f"```python\n{name}{_signature(function)}\n```"
    yield _text(inspect.getdoc(function) or "")


def _signature(thing: Any) -> str:
    """The parameters, one a line where they are many; annotations as they are written."""
    signature = inspect.signature(thing)
    kept = [p for p in signature.parameters.values() if p.name not in ("self", "cls")]
    text = _unquoted(str(signature.replace(parameters=kept)))
    if len(text) <= 90:
        return text
    parameters = [_unquoted(str(p)) for p in kept]
    named = [n for n, p in enumerate(kept) if p.kind is p.KEYWORD_ONLY]
    if named:
        parameters.insert(named[0], "*")
    return "(\n    " + ",\n    ".join(parameters) + ",\n)"


def _unquoted(text: str) -> str:
    return re.sub(r"(: |-> )'([^']*)'", r"\1\2", text)


def _text(docstring: str) -> str:
    """A docstring as Markdown: sections become bold, their entries a list, roles code, examples code."""
    text = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", docstring.replace("``", "`"))
    head, *sections = re.split(r"^(?=\w[\w ]*\n-{3,}$)", text, flags=re.MULTILINE)
    return "\n".join([_example(head), *map(_section, sections)])


def _section(text: str) -> str:
    """``Parameters``, ``Raises`` and the like."""
    title, _, *lines = text.splitlines()
    body = inspect.cleandoc("\n".join(["", *lines]))
    body = re.sub(r"^(\S.*?) : (.*(?:\n    .*)*)", _entry, body, flags=re.MULTILINE)
    body = re.sub(r"^(\w[\w, ]*)\n((?:    .*\n?)+)", _entry, body, flags=re.MULTILINE)
    return f"\n**{title}**\n\n{body}\n"


def _entry(match: re.Match[str]) -> str:
    return f"- `{match[1]}`: {' '.join(match[2].split())}\n"


def _example(text: str) -> str:
    """Indented lines, with the empty lines between them, are code."""
    return re.sub(
        r"^    .*(?:\n(?: {4}.*|(?=\n {4})))*",
        lambda match: f"```python\n{inspect.cleandoc(match[0])}\n```",
        text,
        flags=re.MULTILINE,
    )
