"""Multi-block sets of VTK (.vtm): an index of data sets in nested, named groups, and the files it refers to."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import re
from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path
from xml.etree import ElementTree

from meshdeform_core import interruption
from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FileFormat, Grid
from meshdeform_core.parallel import Ranks

from ..files import replacing_by_all, shown
from .dataset import DataSet, write_blocks
from .xml_arrays import attribute, begin_block
from .xml_arrays import read as read_piece
from .xml_tags import DEEPEST, read_tags

_SET = "vtkMultiBlockDataSet"

# In the folder of the pieces while a set is written; and what it may list.
_JOURNAL = ".meshdeform-unfinished"
_PIECE = re.compile(r"[^/\0]+\.vts")

# Names that become groups which we can read again, below VTKFile and the set itself.
_DEEPEST_NAME = DEEPEST - 3


def read(path: Path, ranks: Ranks) -> tuple[list[DataSet], list[str]]:
    """Read the data sets of an index, in its order, and their names.

    A name consists of the names of the groups and the block, joined by ``/``; a block without a name is called
    ``block1``, ... by its position. Entries without a file are skipped.
    """
    files = list(referenced_files(path))
    if not files:
        raise FormatError(f"{path} refers to no data sets")
    names: list[str] = []
    data_sets: list[DataSet] = []
    for number, (name, piece) in enumerate(files, start=1):
        if not piece.is_file():
            raise FormatError(f"{path} refers to {piece}, which does not exist")
        name = f"{name}block{number}" if name.endswith("/") or not name else name
        names.append(f"{name}_{number}" if name in names else name)
        data_set = read_piece(read_tags(piece), ranks)
        notes = tuple(f"{names[-1]}: {note}" for note in data_set.notes)
        data_sets.append(dataclasses.replace(data_set, notes=notes))
    return data_sets, names


def referenced_files(path: Path) -> Iterator[tuple[str, Path]]:
    """Name, ending in ``/`` where the data set itself has none, and file of each data set."""
    top = read_tags(path).root
    found = top.all(_SET)
    if len(found) != 1:
        raise FormatError(f"{path} has {len(found) or 'no'} {_SET} elements; expected a multi-block index with one")
    # A misplaced end tag would lose blocks, and their interfaces would become walls.
    inside = sum(element.tag == "DataSet" for element in found[0].below())
    if lost := sum(element.tag == "DataSet" for element in top.below()) - inside:
        raise FormatError(f"{path}: {lost} DataSet elements lie outside of {_SET}; expected all of them in it")
    waiting = [(element, "") for element in reversed(found[0].children)]
    while waiting:
        element, prefix = waiting.pop()
        name = prefix + element.get("name")
        if element.tag == "DataSet":
            if file := element.get("file"):
                yield name, path.parent / file
        else:
            below = f"{name}/" if element.get("name") else prefix
            waiting.extend((child, below) for child in reversed(element.children))


def write(grid: Grid, path: Path, variant: FileFormat) -> None:
    """Write the index ``NAME.vtm`` and its pieces ``NAME/NAME_0.vts``, ...; a ``/`` in a block name makes a group.

    The set changes atomically when the new index replaces the old one: the new pieces have names that the old set does
    not use, and the old pieces are removed afterwards. A journal in the folder of the pieces lists the files to be
    added and removed, so that the next run recognises and removes the remains of a killed one.
    """
    ranks = grid.nodes.ranks
    with contextlib.ExitStack() as own:

        def begin() -> tuple[list[str], bytes]:
            require_replaceable(path)
            clean(path)
            # Names of pieces that no file in the folder has.
            taken = set(os.listdir(_folder(path))) if _folder(path).is_dir() else set()
            turns = ("" if turn == 0 else f".{turn}" for turn in count())
            sets = ([f"{path.stem}_{block}{turn}.vts" for block in range(grid.n_blocks)] for turn in turns)
            names = next(names for names in sets if taken.isdisjoint(names))
            index = _index(grid, path, names)
            own.enter_context(interruption.cleaned_up(lambda: clean(path)))
            return names, index

        pieces, index = ranks.on_first(begin)
        with replacing_by_all(path, grid.points) as partial:
            ranks.on_first(lambda: _write_journal(path, pieces))
            write_blocks(grid, [_folder(path) / name for name in pieces], variant, begin_block)
            ranks.on_first(lambda: partial.write_bytes(index))
        ranks.on_first(own.close)


def replaced_files(path: Path) -> list[Path]:
    """The files that writing the set ``path`` replaces or removes: its index and the pieces in its folder."""
    return [path, *(_folder(path) / name for name in _own_pieces(path))]


def require_replaceable(path: Path) -> None:
    """Refuse to replace a folder that contains anything but the pieces of the index ``path``."""
    if path.is_symlink():
        raise FormatError(
            f"cannot write {path}: it is a link, and the pieces of the set would be far from its target; give the "
            f"target itself, {path.resolve()}"
        )
    if shown(path) != str(path):
        raise FormatError(f"cannot write {shown(path)}: its name is not UTF-8, and an index names its pieces in UTF-8")
    folder = _folder(path)
    if not folder.exists():
        return
    if not folder.is_dir():
        raise FormatError(f"cannot write {path}: its pieces go to the folder {folder}, but that is a file")
    known = {_JOURNAL, *_own_pieces(path), *(_journal(folder) if (folder / _JOURNAL).exists() else ())}
    strangers = sorted(name for name in os.listdir(folder) if name not in known)
    if strangers:
        raise FormatError(
            f"cannot write {path}: its pieces go to the folder {folder}, which contains {strangers[0]} and is not "
            "replaced; choose another name or move it away"
        )


def clean(path: Path) -> None:
    """Remove the files that the journal of the set lists and the index does not refer to, then the journal.

    These are the new pieces while the old index is in place, and the old ones once the new index is. Files that the
    system refuses to remove stay in the journal for the next run.
    """
    folder = _folder(path)
    if not (folder / _JOURNAL).exists():
        return
    with contextlib.suppress(OSError, FormatError):
        for name in _journal(folder) - _own_pieces(path):
            (folder / name).unlink(missing_ok=True)
        (folder / _JOURNAL).unlink()
        if not os.listdir(folder):
            folder.rmdir()


def _write_journal(path: Path, pieces: Sequence[str]) -> None:
    """Write the journal: the new pieces, and those that the present index will no longer need."""
    folder = _folder(path)
    folder.mkdir(exist_ok=True)
    # An incomplete journal does no harm: there are no new pieces yet.
    (folder / _JOURNAL).write_text("\n".join([*pieces, *sorted(_own_pieces(path))]), encoding="utf-8")


def _journal(folder: Path) -> set[str]:
    """Names that the journal lists: plain names of files in its folder."""
    lines = (folder / _JOURNAL).read_text(encoding="utf-8", errors="replace").split("\n")
    return {name for name in lines if _PIECE.fullmatch(name)}


def _own_pieces(path: Path) -> set[str]:
    """Names of the files in the folder of the pieces to which the present index refers."""
    if not path.exists():
        return set()
    folder = _folder(path)
    return {piece.name for _, piece in referenced_files(path) if piece.parent == folder}


def _folder(path: Path) -> Path:
    return path.with_suffix("")


def _index(grid: Grid, path: Path, pieces: Sequence[str]) -> bytes:
    root = ElementTree.Element("VTKFile", type=_SET, version="1.0", byte_order="LittleEndian", header_type="UInt64")
    groups = {"": ElementTree.SubElement(root, _SET)}
    for block, name in enumerate(grid.names):
        attribute(name)
        if name.count("/") > _DEEPEST_NAME:
            raise FormatError(
                f"cannot write {path}: the name {name[:40]!r}... is nested more than {_DEEPEST_NAME} deep"
            )
        above, _, leaf = name.rpartition("/")
        parent = _block_group(groups, above)
        file = f"{path.stem}/{pieces[block]}"
        ElementTree.SubElement(parent, "DataSet", index=str(len(parent)), name=leaf, file=file)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _block_group(groups: dict[str, ElementTree.Element], name: str) -> ElementTree.Element:
    if name not in groups:
        above, _, leaf = name.rpartition("/")
        parent = _block_group(groups, above)
        groups[name] = ElementTree.SubElement(parent, "Block", index=str(len(parent)), name=leaf)
    return groups[name]
