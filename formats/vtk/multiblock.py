"""Multi-block sets of VTK (.vtm): an index of data sets in nested, named groups, and the files it refers to."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid

from ..files import replacing
from .dataset import DataSet, VtkFormat
from .xml.read import read as read_piece
from .xml.tags import DEEPEST, Element, read_tags
from .xml.write import attribute, write_block

_SET = "vtkMultiBlockDataSet"

# Names that become groups which we can read again, below VTKFile and the set itself.
_DEEPEST_NAME = DEEPEST - 3


def read(path: Path) -> tuple[list[DataSet], list[str]]:
    """Read the data sets of an index, in its order, and their names.

    A name is made of the names of the groups and of the block, joined by ``/``; a block without name is called
    ``block1``, ... by its place. Places without a file are passed over.

    Raises
    ------
    FormatError
        When the index is damaged or empty, a file is missing, or one is not a structured grid.
    """
    files = list(_files(path))
    if not files:
        raise FormatError(f"{path} refers to no data sets")
    names: list[str] = []
    data_sets: list[DataSet] = []
    for number, (name, piece) in enumerate(files, start=1):
        if not piece.is_file():
            raise FormatError(f"{path} refers to {piece}, which does not exist")
        name = f"{name}block{number}" if name.endswith("/") or not name else name
        names.append(f"{name}_{number}" if name in names else name)
        data_set = read_piece(piece)
        notes = tuple(f"{names[-1]}: {note}" for note in data_set.notes)
        data_sets.append(dataclasses.replace(data_set, notes=notes))
    return data_sets, names


def _files(path: Path) -> Iterator[tuple[str, Path]]:
    """Name, ending in ``/`` where the data set itself has none, and file of each data set."""
    root = _root(path)
    waiting = [(element, "") for element in reversed(root.children)]
    while waiting:
        element, prefix = waiting.pop()
        name = prefix + element.get("name")
        if element.tag == "DataSet":
            if file := element.get("file"):
                yield name, path.parent / file
        else:
            below = f"{name}/" if element.get("name") else prefix
            waiting.extend((child, below) for child in reversed(element.children))


def _root(path: Path) -> Element:
    try:
        found = read_tags(path).root.all(_SET)
    except FormatError as error:
        reason = str(error).rpartition("Error parsing XML: ")[2]
        raise FormatError(f"{path} is not a complete multi-block index: {reason}") from error
    if not found:
        raise FormatError(f"{path} has no {_SET} element; expected a multi-block index")
    return found[0]


def write(grid: Grid, path: Path, variant: VtkFormat) -> None:
    """Write the index ``NAME.vtm`` and its pieces ``NAME/NAME_0.vts``, ...; a ``/`` in a block name makes a group.

    The new set is complete beside the old one before anything changes. Then the old index is moved away, the old
    pieces, the new pieces into their place and, last, the new index: an index never refers to pieces that are not its
    own. An error puts the old set back; a kill between two renames leaves no index.

    Raises
    ------
    FormatError
        When the folder of the pieces holds anything that is not of the old set, or the disk is full.
    """
    require_replaceable(path)
    with replacing(path) as partial:
        staging = partial.with_suffix("")
        new = staging / "new"
        try:
            new.mkdir(parents=True)
            for block in range(grid.n_blocks):
                write_block(grid, block, new / _piece_name(path, block), variant)
            partial.write_bytes(_index(grid, path, variant))
            _exchange([(path, staging / "old.vtm"), (_folder(path), staging / "old"), (new, _folder(path))])
        finally:
            if staging.exists():
                shutil.rmtree(staging)


def require_replaceable(path: Path) -> None:
    """Refuse to replace a folder that holds anything but the pieces of the index ``path``."""
    folder = _folder(path)
    if not folder.exists():
        return
    if not folder.is_dir():
        raise FormatError(f"cannot write {path}: its pieces go to the folder {folder}, but that is a file")
    pieces = {piece for _, piece in _files(path)} if path.exists() else set()
    strangers = sorted(set(folder.iterdir()) - pieces)
    if strangers:
        raise FormatError(
            f"cannot write {path}: its pieces go to the folder {folder}, which holds {strangers[0].name} and is not "
            "replaced; choose another name or move it away"
        )


def _folder(path: Path) -> Path:
    return path.with_suffix("")


def _piece_name(path: Path, block: int) -> str:
    return f"{path.stem}_{block}.vts"


def _index(grid: Grid, path: Path, variant: VtkFormat) -> bytes:
    byte_order = "BigEndian" if variant.options["byte_order"] == "big" else "LittleEndian"
    attributes = {"byte_order": byte_order, "header_type": variant.options["header_type"]}
    root = ElementTree.Element("VTKFile", type=_SET, version="1.0", **attributes)
    groups = {"": ElementTree.SubElement(root, _SET)}
    for block, name in enumerate(grid.names):
        attribute(name)
        if name.count("/") > _DEEPEST_NAME:
            raise FormatError(
                f"cannot write {path}: the name {name[:40]!r}... is nested more than {_DEEPEST_NAME} deep"
            )
        above, _, leaf = name.rpartition("/")
        parent = _group(groups, above)
        file = f"{path.stem}/{_piece_name(path, block)}"
        ElementTree.SubElement(parent, "DataSet", index=str(len(parent)), name=leaf, file=file)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _group(groups: dict[str, ElementTree.Element], name: str) -> ElementTree.Element:
    if name not in groups:
        above, _, leaf = name.rpartition("/")
        parent = _group(groups, above)
        groups[name] = ElementTree.SubElement(parent, "Block", index=str(len(parent)), name=leaf)
    return groups[name]


def _exchange(moves: list[tuple[Path, Path]]) -> None:
    """Rename each file or folder that exists to its target; all or, after an error, none."""
    done: list[tuple[Path, Path]] = []
    try:
        for source, target in moves:
            if source.exists():
                source.rename(target)
                done.append((source, target))
    except BaseException:
        for source, target in reversed(done):
            target.rename(source)
        raise
