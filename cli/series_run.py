"""Implementation of ``meshdeform series`` after its options are parsed."""

from __future__ import annotations

import itertools
import time as clock
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from meshdeform_core import interruption
from meshdeform_core.boundary.motions.motion import Follow
from meshdeform_core.deform import Setup, Timing, set_up
from meshdeform_core.errors import CaseError, FormatError
from meshdeform_core.grid import FileFormat
from meshdeform_core.memory import peak_memory
from meshdeform_core.series import Level, Schedule, deform_series
from meshdeform_core.wording import Notice, counted, first_of_each_kind, kind_of, listed
from meshdeform_formats.case import CaseFile
from meshdeform_formats.case.tables import parse_times
from meshdeform_formats.fields import check_fields, with_fields
from meshdeform_formats.grids import FORMATS, complete_for_export
from meshdeform_formats.inputs import digest, lack, require_no_input
from meshdeform_formats.report.records import Report, level_record, series_head, series_report
from meshdeform_formats.series.manifest import NAME, Manifest, ingredients_of
from meshdeform_formats.series.outputs import FoamFiles, LevelFiles, SeriesFiles

from .options import CaseInput, GridInput, RunInput, SeriesInput
from .process import ProgressBar, stage
from .work import Job, cells_of


@dataclass
class Run:
    """A series ready to run: set-up, schedule, files of the levels, finished levels."""

    job: Job
    setup: Setup
    schedule: Schedule
    files: SeriesFiles
    manifest: Manifest
    timing: Timing
    options: RunInput

    def shortage(self, first: int) -> str:
        """A message on the space that the levels from number ``first`` on lack on the disk; empty if they fit."""
        levels = counted(len(self.schedule.times) - first, "level")
        return lack(self.files.least_bytes(first), self.manifest.path, f"{levels} of the series take")

    def require_space(self, first: int) -> None:
        """Refuse to begin if they lack any."""
        if missing := self.shortage(first):
            raise FormatError(f"cannot write {self.manifest.path.parent}: {missing}")


def prepare(job: Job, source: GridInput, case: CaseInput, wanted: SeriesInput, options: RunInput) -> Run:
    """Determine times and files, topology and boundary; nothing is written."""
    times = times_of(job.case, wanted)
    schedule = Schedule(times, wanted.velocity, case.steps)
    name = name_of(source.path, wanted, job.grid.format)
    check_fields(options.fields, Path(name), True)
    grid = complete_for_export(job.grid, Path(name), options.variant_options)
    kind = FoamFiles if Path(name).suffix.lower() == ".foam" else LevelFiles
    files: SeriesFiles = kind(grid, wanted.output, name, times, options.variant_options, wanted.velocity)
    manifest = Manifest(wanted.output / NAME, {})
    for path in [*files.replaced, manifest.path]:
        require_no_input(path, [file for _, file in (*source.files, *case.files(job.case))])
    output: dict[str, object] = {"output": name, "variant": files.variant.label}
    output |= {"fields": list(options.fields)} if options.fields else {}
    manifest.ingredients = ingredients_of(source.path, source.boundary_file, job.case, schedule, output)
    timing = Timing()
    motion = job.case.case
    if not motion.depends_on_time:
        motion = replace(motion, notes=(*motion.notes, "the motion does not depend on t: all levels are alike"))
    setup = set_up(grid, motion, timing, job.memory)
    files.dress = lambda level: with_fields(cells_of(setup, level), options.fields)
    return Run(job, setup, schedule, files, manifest, timing, options)


def name_of(source: Path, wanted: SeriesInput, form: FileFormat | None) -> str:
    """The name of the grid that a level is written as, before its number."""
    if wanted.suffix:
        suffix = f".{wanted.suffix.removeprefix('.')}"
    elif form is not None and form.name == "openfoam":
        suffix = ".foam"
    else:
        # ADF files can only be read.
        suffix = ".cgns" if source.suffix.lower() in FORMATS["cgns"].suffixes else source.suffix
    return source.stem + suffix


def times_of(case: CaseFile, wanted: SeriesInput) -> tuple[float, ...]:
    """The times of the levels: those asked for, or those of the case's displacement files."""
    if wanted.times:
        return parse_times(wanted.times, "--times")
    motions = [spec.motion for spec in case.case.boundaries if spec.motion is not None]
    found = {step.times for motion in motions for step in motion.steps if isinstance(step, Follow)} - {()}
    if len(found) != 1:
        reason = "has no sequence of displacement files" if not found else "has sequences with different times"
        raise CaseError(f"the case {reason}; give the time levels: --times START:STOP:STEP")
    return found.pop()


def open_manifest(run: Run, resume: bool, force: bool) -> Manifest:
    """Start a series, or continue from the levels finished by an earlier run with the same inputs."""
    new = run.manifest
    # A run that failed before its first level does not block the next one.
    old = Manifest.load(new.path) if new.path.exists() and not force else None
    if old and old.levels and resume:
        old.require_same(new.ingredients)
        run.files.recall(old.levels)
        _keep_what_exists(run, old)
        run.require_space(len(old.levels))
        run.files.clean()
        return old
    present = [new.path] if old and old.levels else [path for path in run.files.outputs if path.exists()]
    if present and not force and not (old and resume):
        hint = "use --resume to continue it, or --force to start again" if old else "use --force to overwrite it"
        raise FormatError(f"{present[0]} exists; {hint}")
    run.require_space(0)
    _tell_of_strangers(run)
    new.path.parent.mkdir(parents=True, exist_ok=True)
    run.files.clean()
    new.save()
    return new


def _tell_of_strangers(run: Run) -> None:
    """Warn of levels of an earlier series in the folder that this one does not replace."""
    folder = run.manifest.path.parent
    try:
        levels = Manifest.load(run.manifest.path).levels
    except (FormatError, OSError):
        return
    replaced = {part for path in run.files.replaced for part in path.relative_to(folder).parts}
    names = dict.fromkeys(str(level.get("file")) for level in levels if isinstance(level, dict))
    left = [name for name in names if name not in replaced and (folder / name).exists()]
    if left:
        run.options.warn([f"levels of an earlier series remain in {folder}, not part of this one: {listed(left)}"])


def _keep_what_exists(run: Run, manifest: Manifest) -> None:
    """Discard levels whose files are missing or not what was written; a complete series must have all its files."""
    files, whole = run.files, manifest.complete and all(path.exists() for path in run.files.outputs)
    changed = [
        number
        for number, written in enumerate(manifest.digests)
        if files.has(number) and digest(files.file(number)) != written
    ]
    if whole and not changed:
        return
    if changed:
        name = files.path(changed[0]).name
        run.options.warn([f"{name} is not what was written: level {changed[0]} and those after it are made again"])
    gone = [] if whole else [number for number in range(len(manifest.levels)) if not files.has(number)]
    for part in manifest.per_level:
        del part[min([*gone, *changed, len(manifest.levels)]) :]
    run.files.recall(manifest.levels)
    manifest.complete = False


def carry_out(run: Run, progress: ProgressBar) -> Report:
    """Make, write and record the missing levels, then report on all."""
    with interruption.continued_by(partial(_how_to_continue, run)):
        files, ranks = run.files, run.job.grid.nodes.ranks
        count, first = len(run.schedule.times), len(run.manifest.levels)
        progress("levels", first, count)
        # The state of earlier levels is known only from files that can be read back.
        done = run.manifest.levels if files.readable else []
        plain = [level["steps"] == 1 and level["repair"] is None for level in done]
        precision, finished = files.variant.precision, files.read
        levels = deform_series(run.setup, run.schedule, precision, progress, first, finished, plain)
        for level in levels:
            # Warnings that do not concern all levels have the number of theirs.
            common = set(map(kind_of, level.result.setup.warnings))
            told = [(text, kind_of(text)) for text in level.result.warnings]
            place = f"level {level.number}"
            run.options.warn(text if kind in common else Notice(f"{place}: {text}", kind) for text, kind in told)
            # First written, then recorded as finished, so that every recorded level exists.
            before = clock.perf_counter()
            if not level.result.valid and not run.options.allow_invalid:
                files.invalid.add(level.number)
            with stage("write"):
                files.write(level.number, level.result.grid, level.velocity, level.faces)
            ranks.on_first(partial(_record, run, level, clock.perf_counter() - before))
            if level.number + 1 < count:
                with run.timing.stage("publish"):
                    files.publish(level.number + 1)
            progress("levels", level.number + 1, count)
        if not run.manifest.complete:
            with run.timing.stage("publish"):
                files.publish(count)
        peak = max(ranks.gather([peak_memory()]))
        report = ranks.on_first(lambda: _complete(run, peak))
    run.options.warn(text for text in report["warnings"] if not text.startswith("level "))
    return report


def _how_to_continue(run: Run) -> str:
    """Advice for an interrupted series; empty if no level is finished, or the last one is needed but cannot be read."""
    done, count = len(run.manifest.levels), len(run.schedule.times)
    if not done or (run.schedule.velocity != "none" and not run.files.readable):
        return ""
    return f"{done} of {count} levels are done: the same command with --resume (without --force) continues"


def _complete(run: Run, peak: int) -> Report:
    manifest, files, schedule = run.manifest, run.files, run.schedule
    if not manifest.complete:
        manifest.complete = True
        manifest.save()
    seconds = {"read": run.job.read_seconds, **run.timing.seconds}
    places = {"folder": str(manifest.path.parent), "view": str(files.view) if files.view else None}
    return series_report(manifest.head, manifest.levels, schedule, places, seconds, peak)


def _record(run: Run, level: Level, seconds: float) -> None:
    """Record a level that has been written."""
    manifest, files = run.manifest, run.files
    manifest.head = manifest.head or series_head(level)
    known = [*map(kind_of, level.result.setup.warnings), *itertools.chain(*manifest.kinds)]
    warnings = first_of_each_kind(level.result.warnings, known)
    record = level_record(level, files.path(level.number).name, seconds, manifest.head, warnings)
    manifest.levels.append(record)
    manifest.kinds.append([kind_of(text) for text in warnings])
    manifest.digests.append(digest(files.file(level.number)))
    try:
        manifest.save()
    except BaseException:
        # The message on a signal states the number of recorded levels.
        for part in manifest.per_level:
            part.pop()
        raise
