"""Delivery of reports to files, stdout and the terminal."""

from __future__ import annotations

import functools
import time as clock
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import click

from meshdeform_core.parallel import Ranks
from meshdeform_formats.report.records import Report, with_other
from meshdeform_formats.report.tables import Illustrate, Illustrations
from meshdeform_formats.report.text import as_text
from meshdeform_formats.report.write import as_json, run_part, write_report

STDOUT = Path("-")


@dataclass(frozen=True)
class Delivery:
    """Data on a command for its report: start time, files read and written, pictures.

    ``start`` is a value of ``time.perf_counter``; ``files`` are pairs of role and path; ``ranks`` shared the work.
    """

    start: float
    files: Sequence[tuple[str, Path | None]]
    illustrate: Illustrate = field(default=Illustrations)
    ranks: Ranks = field(default_factory=Ranks)


def deliver(
    report: Report,
    reports: Iterable[Path],
    to_stdout: bool,
    quiet: bool,
    delivery: Delivery,
    verbose: bool = False,
) -> None:
    """Write the reports; if JSON is requested on stdout, the text goes to stderr; ``verbose``: with all settings."""
    files = [path for path in reports if path != STDOUT]
    to_stdout = to_stdout or STDOUT in reports
    ranks = delivery.ranks
    if files or to_stdout:
        # The command line as it was given, see main.py; the checksums of files take time.
        arguments: Sequence[str] = click.get_current_context().find_root().obj
        report["run"] = ranks.on_first(lambda: run_part(arguments, delivery.files, ranks.count))
    if "timing" in report:
        report["timing"] = with_other(report["timing"], clock.perf_counter() - delivery.start)
    for path in files:
        illustrate = delivery.illustrate
        if ranks.count > 1 and path.suffix == ".html":
            # The pictures take all ranks.
            pictures = illustrate()
            illustrate = functools.partial(lambda drawn: drawn, pictures)
        ranks.on_first(functools.partial(write_report, report, path, illustrate))
    if to_stdout:
        click.echo(as_json(report), nl=False)
    if not quiet:
        # Warnings are already on stderr.
        click.echo(as_text({**report, "warnings": []}, verbose), nl=False, err=to_stdout)
