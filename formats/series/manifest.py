"""``series.json``: the inputs of a series and its finished levels, so that it can be continued and read."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from meshdeform_core.errors import CaseError, FormatError
from meshdeform_core.methods import entry_of
from meshdeform_core.series import REVISION, Schedule
from meshdeform_core.wording import listed

from ..case import CaseFile
from ..files import replacing
from ..inputs import digest

NAME = "series.json"
# Keys of a case that are stored as the options that they resolve to.
_RESOLVED = ("method.", "repair.")


@dataclass
class Manifest:
    """State of a series on disk.

    Attributes
    ----------
    path : of the file
    ingredients : everything that the levels depend on, see :func:`ingredients_of`
    head : the part of the report common to all levels; empty before the first level
    levels : a record of each finished level, in order
    kinds : for each finished level, the kinds of warnings that occurred there first
    digests : for each finished level, that of the file that holds it
    complete : whether all outputs are in their final place
    """

    path: Path
    ingredients: dict[str, Any]
    head: dict[str, Any] = field(default_factory=dict)
    levels: list[dict[str, Any]] = field(default_factory=list)
    kinds: list[list[str]] = field(default_factory=list)
    digests: list[str] = field(default_factory=list)
    complete: bool = False

    def save(self) -> None:
        """Write the file, replacing it as a whole."""
        content = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name not in ("path", "levels")}
        # One line per level: this is written after every level, and Python's own encoder, which indents, is slow.
        levels = ",\n  ".join(json.dumps(level, allow_nan=False) for level in self.levels)
        rest = json.dumps(content, indent=1, allow_nan=False).removeprefix("{")
        with replacing(self.path) as partial:
            partial.write_text(f'{{\n "levels": [\n  {levels}\n ],{rest}\n', encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> Manifest:
        """Read the file. Raises FormatError when it is not a manifest."""
        try:
            content = json.loads(path.read_text(encoding="utf-8"), parse_float=_finite, parse_constant=_finite)
            return cls(path, **content)
        except (ValueError, TypeError, KeyError) as error:
            raise FormatError(
                f"{path} is not the state of a series that this version can continue ({error}); restart the series "
                "with --force"
            ) from error

    @property
    def per_level(self) -> tuple[list[Any], ...]:
        """What is recorded of each finished level."""
        return self.levels, self.kinds, self.digests

    def require_same(self, ingredients: Mapping[str, Any]) -> None:
        """Refuse to continue a series whose inputs have changed. Raises CaseError listing the changes."""
        # Compare as JSON, which has lists instead of tuples.
        now = json.loads(json.dumps(ingredients))
        old, changes = self.ingredients, []
        for key in dict.fromkeys([*old, *now]):
            if key not in now:
                changes.append(f"{key} was removed (was {_shown(old[key])})")
            elif key not in old:
                changes.append(f"{key} is new ({_shown(now[key])})")
            elif old[key] != now[key] and (key == "grid" or key.startswith("file ")):
                changes.append(f"{key} has different contents")
            elif old[key] != now[key]:
                changes.append(f"{key} was {_shown(old[key])}, is {_shown(now[key])}")
        if changes:
            raise CaseError(
                f"cannot continue the series in {self.path.parent}, its inputs have changed: "
                f"{listed(changes, '; ')}. Undo that, write to another folder, or restart it (--force)"
            )


def _finite(word: str) -> float:
    """A number of the file; one that is not finite could not be written again."""
    number = float(word)
    if not math.isfinite(number):
        raise ValueError(f"{word} is not finite")
    return number


def ingredients_of(
    grid: Path, boundary_file: Path | None, case: CaseFile, schedule: Schedule, output: Mapping[str, Any]
) -> dict[str, Any]:
    """Everything that the levels depend on, by name: the contents of the files, keys of the case, times, options.

    Options of the method and of repairs are stored with their values, given or not: another program may have other
    defaults. What an option ``auto`` stands for depends on the grid and on ``algorithms``. ``output`` defines how
    levels are written.
    """
    # The options of the method and of repairs by the names of their keys in a case.
    method, used = case.case.method, entry_of(case.case.method.name).parts
    tables = {part: getattr(method, part) for part in ("idw", "rbf", "tfi") if type(getattr(method, part)) in used}
    options = {"method": {part: dataclasses.asdict(table) for part, table in tables.items()}}
    resolved = _flattened(options | {"repair": dataclasses.asdict(case.case.repair)}, "")
    files = (*case.files, *([boundary_file] if boundary_file else []))
    return {
        "program": f"meshdeform {version('meshdeform')}",
        "algorithms": REVISION,
        "grid": digest(grid),
        **{f"file {path}": digest(path) for path in files},
        **{f"case {key}": value for key, value in _flattened(case.content, "") if not key.startswith(_RESOLVED)},
        "method.name": method.name,
        # JSON has no infinity.
        **{key: str(v) if isinstance(v, float) and not math.isfinite(v) else v for key, v in resolved},
        "tolerance": case.case.tolerance,
        **dataclasses.asdict(schedule),
        **output,
    }


def _flattened(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """``boundary.1.motion.1.rotate.angle`` and its value, for all values of nested tables."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _flattened(item, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and any(isinstance(item, Mapping | list) for item in value):
        for number, item in enumerate(value, 1):
            yield from _flattened(item, f"{name}.{number}")
    else:
        yield name, value


def _shown(value: Any) -> str:
    if isinstance(value, Sequence) and not isinstance(value, str) and len(value) > 4:
        return f"{len(value)} values from {value[0]} to {value[-1]}"
    return repr(value)
