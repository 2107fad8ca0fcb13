"""The patches of a blockMeshDict: names, types, and the block sides that they consist of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Side

from .dictionary import Dictionary
from .entries import Reading, list_of, text_of
from .vertices import Vertices

# Local vertices of the block sides, in the order of Side.
SIDE_VERTICES = ((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7))
# blockMesh numbers block sides like Side does.
_SIDES = tuple(Side)

Sides = dict[tuple[int, ...], list[tuple[int, Side]]]
"""Block sides by their vertices, ascending without repetition."""


@dataclass(frozen=True)
class FoamPatch:
    """A patch: its block sides as (block, side), and its entries other than faces."""

    name: str
    type: str
    sides: tuple[tuple[int, Side], ...]
    content: Dictionary


def read_patches(
    top: Dictionary, vertices: Vertices, blocks: Sequence[tuple[str, tuple[int, ...]]]
) -> tuple[FoamPatch, ...]:
    """The patches of ``boundary`` (or ``patches``, the form before OpenFOAM 2) and the default patch.

    ``blocks`` are names and vertices. Every face must be an outside block side that no other patch has.
    """
    sides: Sides = {}
    for number, (_, corners) in enumerate(blocks):
        for side, local in zip(_SIDES, SIDE_VERTICES, strict=True):
            key = tuple(sorted({corners[v] for v in local}))
            sides.setdefault(key, []).append((number, side))
    declared = _declared(top, vertices, sides) if "boundary" in top.entries else _old_patches(top, vertices, sides)
    owners: dict[tuple[int, Side], str] = {}
    for patch in declared:
        for block, side in patch.sides:
            if owners.setdefault((block, side), patch.name) != patch.name:
                raise FormatError(
                    f"{top.path}: {blocks[block][0]}.{side.label} belongs to the patches "
                    f"{owners[block, side]} and {patch.name}; expected one"
                )
    names = [patch.name for patch in declared]
    if len(set(names)) < len(names):
        raise FormatError(f"{top.path}: two patches are called {max(names, key=names.count)!r}")
    rest = [found[0] for key, found in sides.items() if len(found) == 1 < len(key) - 1 and found[0] not in owners]
    return (*declared, *_default(top, tuple(rest), declared))


def _default(top: Dictionary, sides: tuple[tuple[int, Side], ...], declared: Sequence[FoamPatch]) -> list[FoamPatch]:
    """The patch of all outside faces that no other patch has."""
    found = top.entries.get("defaultPatch")
    content = found if isinstance(found, Dictionary) else Dictionary(top.path, 1)
    name, kind = text_of(content, "name", "defaultFaces"), text_of(content, "type", "empty")
    if not sides:
        return []
    if any(patch.name == name for patch in declared):
        raise FormatError(f"{top.path}: the default patch has the name of another patch, {name!r}")
    return [FoamPatch(name, kind, sides, content)]


def _declared(top: Dictionary, vertices: Vertices, sides: Sides) -> list[FoamPatch]:
    items, found = list_of(top, "boundary"), []
    while items.more:
        name = items.word("the name of a patch")
        content = items.dictionary(f"patch {name}")
        for key in ("type", "faces"):
            if key not in content.entries:
                raise FormatError(f"{top.path}, line {content.line}: the patch {name!r} has no {key}; expected one")
        faces = _faces(list_of(content, "faces"), vertices, sides, name)
        found.append(FoamPatch(name, text_of(content, "type", "patch"), faces, content))
    return found


def _old_patches(top: Dictionary, vertices: Vertices, sides: Sides) -> list[FoamPatch]:
    """``patches ( type name ( faces ) ... )``, the form before OpenFOAM 2."""
    items, found = list_of(top, "patches"), []
    while items.more:
        kind, name = items.word("the type of a patch"), items.word("the name of a patch")
        faces = _faces(items.list("faces"), vertices, sides, name)
        found.append(FoamPatch(name, kind, faces, Dictionary(top.path, items.line)))
    return found


def _faces(items: Reading, vertices: Vertices, sides: Sides, name: str) -> tuple[tuple[int, Side], ...]:
    found: list[tuple[int, Side]] = []
    while items.more:
        face = items.list(f"a face of patch {name}")
        # Two numbers are a block and its side, others are vertices.
        numbers: list[int] = []
        while face.more:
            numbers.append(face.whole("a block and a side") if len(face) == 2 else vertices.take(face))
        found += _sides_of(numbers, sides, items, name)
    return tuple(found)


def _sides_of(numbers: list[int], sides: Sides, items: Reading, name: str) -> list[tuple[int, Side]]:
    """The block side with these vertices, or of this block and number; none if it is collapsed to a line."""
    text = f"patch {name}: the face ({' '.join(map(str, numbers))})"
    if len(numbers) == 2:
        own = [(key, at) for key, found in sides.items() for at in found if at == (numbers[0], numbers[1])]
        key = own[0][0] if own else ()
        wanted = [at for _, at in own]
    else:
        key = tuple(sorted(set(numbers)))
        wanted = sides.get(key, []) if len(numbers) in (3, 4) else []
    if not wanted:
        items.fail(f"{text} is not a side of any block")
    if len(key) < 3:
        return []
    if len(sides[key]) > 1:
        items.fail(f"{text} lies between two blocks; expected an outside face")
    return wanted
