"""``meshdeform schema``: JSON schemas of case files and reports."""

from __future__ import annotations

import json

import click


@click.command("schema")
@click.argument("what", type=click.Choice(["case", "report"]))
def command(what: str) -> int:
    """Print the JSON schema of a case file or of the JSON report.

    \b
    Examples:
      meshdeform schema case > case.schema.json
      meshdeform schema report > report.schema.json

    TOML-aware editors complete and check a case whose first line is `#:schema ./case.schema.json`.
    """
    from meshdeform_formats.case.reader import case_schema
    from meshdeform_formats.report.schema import report_schema

    click.echo(json.dumps(case_schema() if what == "case" else report_schema(), indent=2, ensure_ascii=False))
    return 0
