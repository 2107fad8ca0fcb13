"""Our own reader and writer of VTK's XML files: pieces, encodings, damage, and limits of memory; VTK is the witness."""

import base64
import lzma
import time
import tracemalloc
import zlib

import numpy as np
import pytest
import vtk_witness

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Field, Grid
from meshdeform_formats import read_grid, write_grid
from meshdeform_formats.displacement import read_displacement

CUBE = np.stack(np.meshgrid([0.0, 1.0], [0.0, 1.0], [0.0, 1.0], indexing="ij"), axis=-1)


def array(values, name="Points", kind="Float64", components=3, text=None, **attributes):
    words = {"type": kind, "Name": name, "NumberOfComponents": components, "format": "ascii"} | attributes
    tag = " ".join(f'{key}="{value}"' for key, value in words.items())
    text = " ".join(map(str, np.ravel(values).tolist())) if text is None else text
    return f"<DataArray {tag}>{text}</DataArray>"


def piece(extent, points, data="", cells=""):
    return (
        f'<Piece Extent="{extent}"><PointData>{data}</PointData><CellData>{cells}</CellData>'
        f"<Points>{points}</Points></Piece>"
    )


def vts(*pieces, whole="0 2 0 1 0 0", root=""):
    return (
        f'<VTKFile type="StructuredGrid" byte_order="LittleEndian"{root}><StructuredGrid WholeExtent="{whole}">'
        + "".join(pieces)
        + "</StructuredGrid></VTKFile>"
    )


PLANE = np.array([[x, y, 0.0] for y in range(2) for x in range(3)])
LEFT, RIGHT = PLANE[[0, 1, 3, 4]], PLANE[[1, 2, 4, 5]]


def scalar(values, name="p", **attributes):
    return array(values, name, components=1, **attributes)


def base64_array(values, header="<u4"):
    raw = np.asarray(values, "<f8").tobytes()
    return base64.b64encode(np.array([len(raw)], header).tobytes() + raw).decode()


def one(points, data=""):
    """A file of one piece, the whole extent."""
    return vts(piece("0 2 0 1 0 0", points, data))


def appended(data, encoding="raw", root="", offset=0, points=PLANE):
    head = vts(piece("0 2 0 1 0 0", array([], text="", format="appended", offset=offset)), root=root)
    head = head.removesuffix("</VTKFile>") + f'<AppendedData encoding="{encoding}">_'
    return head.encode() + data + b"</AppendedData></VTKFile>"


RAW = np.array([144], "<u4").tobytes() + PLANE.tobytes()
ZLIB = ' compressor="vtkZLibDataCompressor"'
LZMA = ' compressor="vtkLZMADataCompressor"'


def packed(*blocks, sizes=(144, 0), pack=zlib.compress):
    parts = [pack(block) for block in blocks]
    return np.array([len(blocks), *sizes, *map(len, parts)], "<u4").tobytes() + b"".join(parts)


ONE = one(array(PLANE))
GOOD = {
    "one piece": ONE,
    "an empty piece": ONE.replace("<Piece", piece("0 -1 0 -1 0 -1", array([])) + "<Piece"),
    "extended by a comment": "<!-- a <!DOCTYPE in a comment -->" + ONE,
    "blanks around base64": one(array([], text=f"\n  {base64_array(PLANE)}\t\r\n ", format="binary")),
    "blank lines behind the end": ONE + "\n\r\n",
    "raw": appended(RAW + b"\n \t\r\n") + b"\r\n\0\0",
    "base64": appended(base64.b64encode(RAW) + b"\n", "base64"),
    "a tag in the data": appended(b"</VTKFile><Piece &" + RAW, offset=18),
    "two blocks": appended(packed(PLANE.tobytes()[:100], PLANE.tobytes()[100:], sizes=(100, 44)), root=ZLIB),
    "lzma": appended(packed(PLANE.tobytes(), pack=lzma.compress), root=LZMA),
}


@pytest.mark.parametrize("name", GOOD)
def test_good_files(tmp_path, name):
    content = GOOD[name]
    (tmp_path / "a.vts").write_bytes(content.encode() if isinstance(content, str) else content)
    np.testing.assert_array_equal(read_grid(tmp_path / "a.vts").block(0), PLANE.reshape(1, 2, 3, 3).swapaxes(0, 2))


LAUGHS = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 10))

BAD = {
    "a piece of the extent": (
        vts(piece("0 1 0 1 0 0", array(LEFT)), piece("1 2 0 1 0 0", array(RIGHT))),
        "Piece has Extent 0 1 0 1 0 0; expected one Piece with all nodes of the WholeExtent 0 2 0 1 0 0",
    ),
    "another data set": (ONE.replace('type="StructuredGrid"', 'type="PolyData"'), "is a polygon surface"),
    "another byte order": (ONE.replace("LittleEndian", "Middle"), "has byte_order 'Middle'; known are Little"),
    "another compressor": (ONE.replace("<VTKFile", '<VTKFile compressor="gz"'), "has compressor 'gz'; known are"),
    "a truncated file": (ONE.replace("</VTKFile>", ""), "does not end with </VTKFile>; the file is truncated"),
    "another end tag": (ONE.replace("</Points>", "</Point>"), "Error parsing XML"),
    "no size": (one(array([], text="AAAA", format="binary")), "has an impossible size, at byte"),
    "no piece": (vts(), "is an empty grid"),
    "no points": (one(""), "has 0 arrays of Points, expected 1"),
    "too many values": (one(array([*PLANE.ravel(), 1])), r"Points has 19 values, expected 18 values \(6 x 3\)"),
    "values behind an element": (
        one(array([], text="0 <InformationKey/> 1 2")), "Points continues after an element inside it: '1 2'"
    ),
    "values behind a comment": (one(array([], text="0 <!-- x --> 1")), "holds '<!--'"),
    "a character reference": (one(array([], text="&#48; 1")), "holds '&#48;'"),
    "a number out of range": (one(array([], text="1e999")), "a number out of range"),
    "an integer that does not fit": (
        one(array(PLANE), scalar([0, 0, 0, 0, 0, 256], kind="UInt8")), "p holds '256', expected uint8 numbers"
    ),
    **{f"the integer {n}": (one(array(PLANE), scalar([], kind="Int64", text=f"1 2 3 4 5 {n}")), f"p holds '{n}'")
       for n in (2**63, -(2**63) - 1)},
    "a fraction for an integer": (one(array(PLANE), scalar([0, 0, 0, 0, 0, 0.5], kind="Int32")), "p holds '0.0'"),
    "two components of points": (one(array(PLANE, components=2)), "has 2 components, expected 3"),
    "very many components": (one(array(PLANE), array([], "q", components=10**17)), "q has 0 values, expected 6000"),
    "an unknown type": (one(array(PLANE, kind="Float128")), "type 'Float128'; known are Int8"),
    "an unknown format": (one(array(PLANE, format="hex")), "format 'hex'; known are ascii"),
    "no appended data": (
        one(array([], format="appended", offset=0)), "refers to appended data, but the file has none"
    ),
    "fewer bytes than values": (
        one(array([], text=base64_array(PLANE[:5]), format="binary")), "has 120 bytes, expected 144"
    ),
    "more bytes than stated": (
        one(array([], text=base64_array(PLANE) + "AAAA", format="binary")), "continues after its last"
    ),
    "no base64": (one(array([], text=base64_array(PLANE)[:-4] + "?==A", format="binary")), "not base64"),
    "five numbers in an extent": (ONE.replace(' Extent="0 2 0 1 0 0"', ' Extent="0 2 0 1 0"'), "expected six whole"),
    "a long extent": (ONE.replace('WholeExtent="0 2 0 1 0 0"', 'WholeExtent="0 2 0 1 0 99999999"'),
                      "cannot hold 600000000 entries"),
    "no data set": ('<VTKFile type="StructuredGrid"></VTKFile>', "has no StructuredGrid element"),
    "time steps": (ONE.replace("WholeExtent", 'TimeValues="0 1" WholeExtent'), "contains 2 time steps"),
    "entities": (
        f'<!DOCTYPE VTKFile [<!ENTITY l0 "lol">{LAUGHS}]>' + one(array([], text="&l9;")), "a VTK file has no DOCTYPE"
    ),
    "another encoding": ('<?xml version="1.0" encoding="EBCDIC-CP-US"?>' + ONE, "encoded as EBCDIC-CP-US"),
    "deep": (vts("<a>" * 5000 + "</a>" * 5000), "elements are nested more than 100 deep"),
    "another root": ("<a>" + ONE + "</a><!-- </VTKFile>", "its first element is not VTKFile"),
    "an offset behind the end": (appended(RAW, offset=999), "begins at byte .*, after the end of the appended data"),
    "no offset": (appended(RAW, offset="x"), "has offset 'x', expected a count"),
    "too little": (appended(RAW[:-1]), "Points has an impossible size, at byte"),
    "another size": (appended(np.array([136], "<u4").tobytes() + RAW[4:]), "has 136 bytes, expected 144"),
    "no underscore": (appended(RAW).replace(b">_", b"> "), "no '_' follows the AppendedData tag"),
    "no end of the data": (appended(RAW).replace(b"</Appended", b"</appended"), "do not end with </AppendedData>"),
    "an unknown encoding": (appended(RAW, "hex"), "has encoding 'hex'; known are base64 raw"),
    "zlib that is none": (appended(packed(PLANE.tobytes(), pack=bytes), root=ZLIB), "damaged in block 1 of 1"),
    "zlib that is cut": (
        appended(packed(PLANE.tobytes(), pack=lambda b: zlib.compress(b)[:-4]), root=ZLIB), "it has no end"
    ),
    "zlib of less": (appended(packed(PLANE.tobytes()[:-1]), root=ZLIB), "decompresses to 143 bytes, expected 144"),
    "more blocks than bytes": (
        appended(np.array([2**30, 144, 0], "<u4").tobytes() + b"x" * 99, root=ZLIB), "Points has an impossible size"
    ),
    "a line that exists twice": (appended(RAW[:40] + RAW[20:]), "Points continues after its last value"),
    "base64 after the last array": (appended(base64.b64encode(RAW) + b"AAAA", "base64"), "after its last value"),
    "lzma that needs memory": (
        appended(
            packed(
                PLANE.tobytes(),
                pack=lambda b: lzma.compress(b, filters=[{"id": lzma.FILTER_LZMA2, "preset": 1, "dict_size": 1 << 28}]),
            ),
            root=LZMA,
        ),
        "Memory usage limit",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_files(tmp_path, capfd, name):
    text, message = BAD[name]
    (tmp_path / "a.vts").write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(FormatError, match=message) as error:
        read_grid(tmp_path / "a.vts")
    assert str(tmp_path / "a.vts") in str(error.value)
    assert capfd.readouterr() == ("", "")


LONG = f"{-(2**63)} {2**63 - 1} 0 -1 +5 7", f"{2**64 - 1} {2**63} 0 1 2 3"
ENDS = {"Int64": LONG[0], "UInt64": LONG[1], "Float32": "INF -Inf Infinity 1e38 -0.5 7"}


@pytest.mark.parametrize(("kind", "words"), ENDS.items())
def test_numbers_at_the_ends_of_their_types_and_arrays_without_names(tmp_path, kind, words):
    (tmp_path / "a.vts").write_text(one(array(PLANE), scalar(range(6), "") + scalar([], "", kind=kind, text=words)))
    _, field = fields = read_grid(tmp_path / "a.vts").fields
    assert [each.name for each in fields] == ["array0", "array1"]
    wanted = [np.float32(word) if kind == "Float32" else int(word) for word in words.split()]
    assert field.values.ravel(order="F").tolist() == wanted


def repeated_array():
    """Fields of 6 MB each that share one packed array of a few kB."""
    shared = packed(bytes(6_000_000), sizes=(6_000_000, 0))
    points = packed(np.zeros((250_000, 3)).tobytes(), sizes=(6_000_000, 0))
    arrays = "".join(array([], f"f{n}", components=3, format="appended", offset=0) for n in range(300))
    head = vts(
        piece("0 249999 0 0 0 0", array([], format="appended", offset=len(shared)), arrays),
        whole="0 249999 0 0 0 0",
        root=ZLIB,
    )
    head = head.removesuffix("</VTKFile>") + '<AppendedData encoding="raw">_'
    return head.encode() + shared + points + b"</AppendedData></VTKFile>"


SMALL_BUT_LARGE = {
    "one array many times": repeated_array,
    "a bomb": lambda: appended(packed(bytes(100_000_000), sizes=(100_000_000, 0)), root=ZLIB),
}


@pytest.mark.parametrize("name", SMALL_BUT_LARGE)
def test_small_files_take_little_memory_and_time(tmp_path, name):
    (tmp_path / "a.vts").write_bytes(SMALL_BUT_LARGE[name]())
    tracemalloc.start()
    start = time.process_time()
    with pytest.raises(FormatError):
        read_grid(tmp_path / "a.vts")
    seconds, (_, peak) = time.process_time() - start, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert seconds < 5
    assert peak < 200e6


NAMES = ["\"<&>'", "tab\tand\nline", "größe ∂", "]]>", "a  b "]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("encoding", ["ascii", "appended"])
def test_names_of_arrays(tmp_path, name, encoding):
    fields = (Field(name, "node", 0, np.arange(8.0).reshape(2, 2, 2)),)
    write_grid(Grid.from_blocks([CUBE], fields=fields), tmp_path / "a.vts", {"encoding": encoding})
    assert read_grid(tmp_path / "a.vts").fields[0].name == name
    assert list(vtk_witness.read(tmp_path / "a.vts")[1]) == [("node", name)]


@pytest.mark.parametrize("name", ["bell\a", "nul\0", "half\ud800"])
@pytest.mark.parametrize("target", ["a.vts", "a.vtm"])
def test_names_that_xml_cannot_hold(tmp_path, name, target):
    fields = (Field(name, "node", 0, np.arange(8.0).reshape(2, 2, 2)),)
    with pytest.raises(FormatError, match="which a VTK file cannot hold"):
        write_grid(Grid.from_blocks([CUBE], fields=fields), tmp_path / target)
    with pytest.raises(FormatError, match="which a VTK file cannot hold"):
        write_grid(Grid.from_blocks([CUBE], [name]), tmp_path / "a.vtm")
    assert not list(tmp_path.iterdir())


def test_pieces_of_a_surface(tmp_path):
    one = (
        '<Piece NumberOfPoints="3" NumberOfCells="1"><PointData>{moves}</PointData><Points>{points}</Points><Cells>'
        + array([0, 1, 2], "connectivity", "Int64", 1)
        + array([3], "offsets", "Int64", 1)
        + array([5], "types", "UInt8", 1)
        + "</Cells></Piece>"
    )
    points = np.arange(18.0).reshape(6, 3)
    pieces = [one.format(points=array(p), moves=array(p + 0.5, "disp")) for p in (points[:3], points[3:])]
    empty = '<Piece NumberOfPoints="0" NumberOfCells="0"></Piece>'
    frame = (
        '<VTKFile type="UnstructuredGrid" byte_order="LittleEndian"><UnstructuredGrid>{}</UnstructuredGrid></VTKFile>'
    )
    (tmp_path / "a.vtu").write_text(frame.format(f"{empty}{pieces[0]}"))
    data = read_displacement(tmp_path / "a.vtu")
    np.testing.assert_array_equal(data.points, points[:3])
    np.testing.assert_array_equal(data.displacement, points[:3] + 0.5)
    assert data.triangles.tolist() == [[0, 1, 2]]
    (tmp_path / "a.vtu").write_text(frame.format("".join(pieces)))
    with pytest.raises(FormatError, match="has 2 pieces; merge them into one"):
        read_displacement(tmp_path / "a.vtu")
