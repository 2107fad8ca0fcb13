"""Seeded changes of valid files, such as copying, editing and full disks make."""

import copy
import re
from collections.abc import Callable, Iterator
from random import Random
from typing import Any

import numpy as np
from cgns_witness import N

Mutation = Callable[[bytes, Random], bytes]


def _splice(change: Callable[[Any, Random], Any], longest: int = 64, of_lines: bool = False) -> Mutation:
    """A mutation that changes some bytes, or lines, that follow each other; at least one."""

    def mutation(data: bytes, rng: Random) -> bytes:
        whole = data.splitlines(keepends=True) if of_lines else data
        first = rng.randrange(len(whole))
        last = min(len(whole), first + rng.randrange(1, longest))
        found = whole[:first] + change(whole[first:last], rng) + whole[last:]
        return b"".join(found) if of_lines else found

    return mutation


_flip = _splice(lambda part, rng: bytes([part[0] ^ (1 << rng.randrange(8))]) + part[1:])
_repeat = _splice(lambda part, rng: part + part)
_drop = _splice(lambda part, rng: b"")
_blank = _splice(lambda part, rng: bytes([rng.choice((0, 255, 32, 10))]) * len(part), longest=16)
# Some lines stand there twice.
_again = _splice(lambda part, rng: part + part, longest=12, of_lines=True)


def _truncate(data: bytes, rng: Random) -> bytes:
    return data[: rng.randrange(len(data))]


def _extend(data: bytes, rng: Random) -> bytes:
    return data + rng.randbytes(rng.randrange(1, 40))


def _replaced(pattern: bytes, *values: bytes) -> Mutation:
    """A mutation that puts one of ``values`` in place of something that has the pattern."""

    def mutation(data: bytes, rng: Random) -> bytes:
        found = list(re.finditer(pattern, data))
        if not found:
            return _flip(data, rng)
        match = rng.choice(found)
        return data[: match.start()] + rng.choice(values) + data[match.end() :]

    return mutation


_number = _replaced(
    rb"[-+.\d][-+.\deE]*", *b"0 -1 1e400 nan inf 1e-320 99999999999 0x1p3 1.5.2 3*0.0 1e200".split(), b""
)
# The likeliest change to go unnoticed.
_digit = _replaced(rb"[-+\d]", b"0", b"1", b"5", b"9", b"-", b"+", b" ")


def _lines(data: bytes, rng: Random) -> bytes:
    lines = data.splitlines(keepends=True)
    one, two = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[one], lines[two] = lines[two], lines[one]
    return b"".join(lines)


def _fields(data: bytes, rng: Random) -> bytes:
    """Two words of a line change places."""
    lines = data.splitlines(keepends=True)
    at = rng.randrange(len(lines))
    words = re.split(rb"([\s,]+)", lines[at])
    one, two = (2 * rng.randrange((len(words) + 1) // 2) for _ in range(2))
    words[one], words[two] = words[two], words[one]
    lines[at] = b"".join(words)
    return b"".join(lines)


def _editor(data: bytes, rng: Random) -> bytes:
    """What editors do to a whole file: ends of lines, a byte order mark, another encoding, no last end of line."""
    blank = rng.choice((b"\t", b"\xc2\xa0", b"\x0b", b"  "))
    return rng.choice((
        data.replace(b"\n", b"\r\n"), data.replace(b"\n", b"\r"), b"\xef\xbb\xbf" + data,
        data.decode("latin-1").encode("utf-16"), data.rstrip(), data.replace(b" ", blank),
    ))  # fmt: skip


def _letters(data: bytes, rng: Random) -> bytes:
    """Digits of another script, signs that look alike, a decimal comma, case of letters."""
    old = bytes([rng.choice(re.findall(rb"[-.\da-zA-Z]", data) or [b"x"])[0]])
    new = {b"-": "\u2212".encode(), b".": b","}.get(old, old.swapcase())
    if old.isdigit():
        new = chr(rng.choice((0xFF10, 0x660)) + int(old)).encode()
    at = rng.randrange(data.count(old) or 1)
    parts = data.split(old)
    return old.join(parts[: at + 1]) + new + old.join(parts[at + 1 :])


BINARY: tuple[Mutation, ...] = (_flip, _truncate, _extend, _repeat, _drop, _blank)
TEXT = (
    *BINARY, _number, _number, _number, _lines, _fields, _fields, _again, _editor, _letters,
    _digit, _digit, _digit, _digit,
)  # fmt: skip


def mutated(data: bytes, text: bool, rng: Random) -> bytes:
    """``data`` with one to three changes."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        data = rng.choice(TEXT if text else BINARY)(data, rng) or b"\n"
    return data


ODD = (0.0, -0.0, 1.0, -1.0, np.nan, np.inf, -np.inf, 1e-310, 5e-324, 1e29, 1e31, 1e300, 2.0**31, -(2.0**63))
_COUNTS = (0, 1, -1, 2, 3, 7, 2**16, 2**31 - 1, -(2**31))


# --- CGNS -----------------------------------------------------------------------------------------------------------


def _nodes(node: N) -> Iterator[tuple[N, N]]:
    """Every node with its parent."""
    for child in node.children:
        yield node, child
        yield from _nodes(child)


def cgns_tree(root: N, rng: Random) -> N:
    """A tree with one or two nodes changed."""
    root = copy.deepcopy(root)
    for _ in range(rng.choice((1, 1, 2))):
        pairs = list(_nodes(root))
        parent, node = rng.choice(pairs)
        _damage_node(parent, node, [child for _, child in pairs], rng)
    return root


def _damage_node(parent: N, node: N, all_nodes: list[N], rng: Random) -> None:
    kind = rng.randrange(10)
    other = rng.choice(all_nodes)
    if kind == 0:
        node.name = rng.choice((other.name, node.name.lower(), "x" * 32, "A B", "\u00e4"))
    elif kind == 1:
        node.label = rng.choice((other.label, "", "UserDefinedData_t", node.label.upper()[:32]))
    elif kind == 2:
        parent.children.remove(node)
    elif kind == 3:
        again = copy.deepcopy(node)
        again.name = rng.choice((node.name + "2", "again"))
        parent.children.insert(rng.randrange(len(parent.children) + 1), again)
    elif kind == 4:
        node.children.append(_addition(rng))
    elif kind == 5:
        rng.shuffle(parent.children)
    elif kind == 6:
        node.link = rng.choice((("", "/Base/left"), ("", "/nowhere"), ("gone.cgns", "/Base"), ("", "/")))
    else:
        node.data = _damaged_data(node.data, other.data, rng)


_RINDS = ([0] * 6, [1, 0, 0, 0, 0, 0], [1] * 6, [-1] * 6, [9] * 6)


def _addition(rng: Random) -> N:
    """A node that the standard knows and that changes the meaning of others, or not."""
    return copy.deepcopy(
        rng.choice(
            (
                N("Rind", "Rind_t", np.array(rng.choice(_RINDS), "i4")),
                N("DataClass", "DataClass_t", rng.choice(("Dimensional", "NormalizedByDimensional"))),
                N("DataConversion", "DataConversion_t", np.array([2.0, 1.0])),
                N("GridLocation", "GridLocation_t", rng.choice(("CellCenter", "Vertex", "KFaceCenter"))),
                N("Ordinal", "Ordinal_t", np.array([7], "i4")),
                N("GridCoordinates", "GridCoordinates_t", None),
                N("odd", "UserDefinedData_t", np.zeros((2, 0))),
            )
        )
    )


def _damaged_data(data: Any, other: Any, rng: Random) -> Any:
    if data is None or isinstance(data, str) or rng.random() < 0.15:
        return rng.choice((other, None, "", "Unstructured", "Null", np.zeros(0), np.array([3], "i4")))
    array, kind = np.array(data), rng.randrange(6)
    if kind == 0:
        with np.errstate(all="ignore"):
            return array.astype(rng.choice(("i4", "i8", "f4", "f8")))
    if kind == 1:
        return np.ascontiguousarray(array.T)
    if kind == 2 and len(array) > 1:
        return array[:-1]
    if kind == 3:
        return array.reshape(-1)
    if array.size:
        array = array.copy()
        with np.errstate(all="ignore"):
            values = _COUNTS if array.dtype.kind in "iu" else ODD
            array.reshape(-1)[rng.randrange(array.size)] = np.array(rng.choice(values)).astype(array.dtype)
    return array


# --- tags -----------------------------------------------------------------------------------------------------------

_VALUES = {
    b"type": tuple(b"Float32 Float64 Int32 UInt8 StructuredGrid ImageData vtkMultiBlockDataSet".split()),
    b"format": (b"ascii", b"binary", b"appended", b"Ascii", b""),
    b"encoding": (b"raw", b"base64", b"hex"),
    b"header_type": (b"UInt32", b"UInt64", b"Int8"),
    b"byte_order": (b"LittleEndian", b"BigEndian", b"big"),
    b"compressor": (b"vtkZLibDataCompressor", b"vtkLZMADataCompressor", b"vtkLZ4DataCompressor", b"none", b""),
    b"NumberOfComponents": (b"1", b"2", b"3", b"4", b"9", b"-3", b"2147483647", b""),
    b"version": (b"0.1", b"1.0", b"2.2", b"9.9", b""),
}
_ANY = (b"", b"0", b"1", b"-1", b"0 0 0 0 0 0", b"0 2 0 2 0 2", b"1 3 1 4 0 2", b"nan", b"99999999999", b"&amp;", b"<")
_ATTRIBUTE = re.compile(rb'(\w+)(\s*=\s*)"([^"]*)"')


def tags(data: bytes, rng: Random) -> bytes:
    """XML with one or two tags or attributes changed; what is appended stays as it is."""
    at = data.find(b"<AppendedData")
    end = data.find(b"_", at) if at >= 0 else len(data)
    head, tail = data[:end], data[end:]
    for _ in range(rng.choice((1, 1, 2))):
        head = _attribute(head, rng) if rng.random() < 0.6 else _tag(head, rng)
    return head + tail


def _attribute(data: bytes, rng: Random) -> bytes:
    found = list(_ATTRIBUTE.finditer(data))
    if not found:
        return data
    match = rng.choice(found)
    name, kind = match[1], rng.randrange(6)
    if kind == 0:
        new = b""
    elif kind == 1:
        new = match[0] + b" " + match[0]
    elif kind == 2:
        new = name + match[2] + b'"' + rng.choice(found)[3] + b'"'
    elif kind == 3:
        new = name.swapcase() + match[2] + b'"' + match[3] + b'"'
    else:
        new = name + match[2] + b'"' + rng.choice(_VALUES.get(name, _ANY)) + b'"'
    return data[: match.start()] + new + data[match.end() :]


def _tag(data: bytes, rng: Random) -> bytes:
    pieces = re.split(rb"(<[^>]*>)", data)
    places = range(1, len(pieces), 2)
    one, two = rng.choice(places), rng.choice(places)
    kind = rng.randrange(5)
    if kind == 0:
        pieces[one], pieces[two] = pieces[two], pieces[one]
    elif kind == 1:
        low, high = sorted((one, two))
        pieces[low:low] = pieces[low : high + 1]
    elif kind == 2:
        low, high = sorted((one, min(two, one + 6)))
        del pieces[low : high + 1]
    elif kind == 3:
        pieces[one] = b"<!--" + pieces[one] + b"-->"
    else:
        start = b'<?xml version="1.0" encoding="%s"?>' % rng.choice((b"UTF-8", b"latin-1", b"utf-16", b"x-odd"))
        return start + (b"\n" if rng.random() < 0.5 else b"<!-- a -->") + data
    return b"".join(pieces)
